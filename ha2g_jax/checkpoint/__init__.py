"""Store a model on disk: training state, checkpoints of a run, and the folder that a model is shipped in."""
