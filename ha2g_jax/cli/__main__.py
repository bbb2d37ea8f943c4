"""`python -m ha2g_jax.cli` is `ha2g`."""

import sys

from ha2g_jax.cli import main

sys.exit(main())
