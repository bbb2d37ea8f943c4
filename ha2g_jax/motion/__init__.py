"""Finished motion: the value that generation returns, its file, its resampling and its video."""
