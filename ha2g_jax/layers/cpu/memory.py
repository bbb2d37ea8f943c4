"""Memory that a program keeps between its steps, instead of returning it to the system."""

import ctypes
import importlib.util
import sys

# Parameters of mallopt in malloc.h of glibc.
_TRIM_THRESHOLD, _MMAP_MAX = -1, -4
_ACCELERATORS = ("jax_plugins", "libtpu")  # packages with which JAX computes on GPUs and TPUs


def has_accelerator_plugin() -> bool:
    """Return whether a JAX plugin for an accelerator is installed; the accelerator itself may be missing."""
    return any(map(importlib.util.find_spec, _ACCELERATORS))


def keep_memory() -> None:
    """Let this process keep the memory that it frees, so that a training step on a CPU does not wait for new pages.

    XLA requests the memory of a step when the step begins and frees it at its end. glibc returns such large blocks to
    the system, which has to clear each page again for the next step: a quarter of the processor time of a step
    (docs/performance.md). Without mappings for single requests and without trimming, the same memory serves all steps.

    glibc can keep such blocks for the main thread alone, since the arenas of other threads are too small for them. JAX
    therefore runs its programs in the thread that calls them. A single arena for all threads could keep them too, but a
    compilation leaves it in more than 100,000 pieces, and each request of the step's threads then searches them.

    Call this in the main thread before the first computation, and train in that thread. It does nothing where JAX has a
    plugin for an accelerator, which has its own memory, and on systems without glibc.
    """
    if sys.platform != "linux" or has_accelerator_plugin():
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt:  # musl has none
        for parameter, value in ((_MMAP_MAX, 0), (_TRIM_THRESHOLD, -1)):
            mallopt(parameter, value)
        import jax  # here, since most commands that import this module do not train

        jax.config.update("jax_cpu_enable_async_dispatch", False)
