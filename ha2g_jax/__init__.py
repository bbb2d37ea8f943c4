"""Speech in, gestures out: HA2G (Liu et al., CVPR 2022) in JAX."""

__version__ = "0.1.0"
__all__ = ["load"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str):
    # Imported on first use, so that `import ha2g_jax` and the data tools start without JAX.
    if name == "load":
        from ha2g_jax.synthesis import load

        return load
    raise AttributeError(f"module 'ha2g_jax' has no attribute {name!r}")
