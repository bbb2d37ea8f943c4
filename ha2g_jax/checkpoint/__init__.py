"""Store a model on disk: training state, checkpoints of a run, and the folder in which a model is shipped."""

CONFIG, ASSETS, WEIGHTS = "config.json", "assets.json", "model.safetensors"  # of a model folder
BEST, LATEST, FAILED = "best", "latest", "failed"  # folders of checkpoints in a workdir
CHECKSUMS = "SHA256SUMS"  # of a checkpoint
RUN = "run.json"  # record of a workdir
