"""Train a model: python experiments/launch.py --config=FILE[:SIZE] --workdir=DIR [--config.KEY=VALUE ...]."""

import sys

from ha2g_jax import cli
from ha2g_jax.train.memory import keep_memory

if __name__ == "__main__":
    keep_memory()
    sys.exit(cli.main(["train", *sys.argv[1:]]))
