"""What a process that trains sets up before its first computation."""

from ha2g_jax.files.cache import keep_programs
from ha2g_jax.layers.cpu.memory import has_accelerator_plugin, keep_memory


def prepare_process() -> None:
    """Let this process keep its compiled programs and its memory, and use oneDNN where that is installed.

    Call this in the main thread before JAX is imported; see `keep_programs`, `keep_memory` and `use_onednn`.
    """
    keep_programs()
    keep_memory()
    if has_accelerator_plugin():
        return
    from ha2g_jax.layers.cpu.onednn.library import use_onednn

    use_onednn()
