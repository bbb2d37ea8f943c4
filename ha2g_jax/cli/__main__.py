"""Run the `ha2g` command by `python -m ha2g_jax.cli`."""

import sys

from ha2g_jax.cli import main

sys.exit(main())
