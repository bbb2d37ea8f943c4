"""Train a model: python experiments/launch.py --config=FILE[:SIZE] --workdir=DIR [--config.KEY=VALUE ...]."""

import sys

from ha2g_jax import cli
from ha2g_jax.launch import prepare_process

if __name__ == "__main__":
    prepare_process()
    sys.exit(cli.main(["train", *sys.argv[1:]]))
