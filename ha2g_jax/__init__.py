"""Speech in, gestures out: HA2G (Liu et al., CVPR 2022) in JAX."""

import importlib

__version__ = "0.1.0"
__all__ = ["Motion", "Style", "UserError", "load"]

_MODULES = {"Motion": "motion.motion", "Style": "synthesis", "UserError": "errors", "load": "synthesis"}


def __getattr__(name: str):
    # Imported on first use, so that `import ha2g_jax` and the data commands start without JAX.
    if name not in _MODULES:
        raise AttributeError(f"module 'ha2g_jax' has no attribute {name!r}")
    return getattr(importlib.import_module(f"ha2g_jax.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
