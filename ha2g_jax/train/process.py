"""What a process that trains sets up before its first computation."""

from ha2g_jax.files.cache import keep_programs
from ha2g_jax.layers.cpu.memory import keep_memory


def prepare_process() -> None:
    """Let this process keep its compiled programs and its memory.

    Call this in the main thread before JAX is imported; see `keep_programs` and `keep_memory`.
    """
    keep_programs()
    keep_memory()
