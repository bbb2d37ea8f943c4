"""Read and write files safely: archives of arrays, whole files or none, cache folders, child processes."""
