"""Train a model: python experiments/launch.py --config=FILE[:SIZE] --workdir=DIR [--config.KEY=VALUE ...]."""

import sys

from ha2g_jax import cli

if __name__ == "__main__":
    sys.exit(cli.main(["train", *sys.argv[1:]]))
