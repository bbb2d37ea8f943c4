"""The memory of processes."""

import resource
import sys


def peak_memory(who: int = resource.RUSAGE_SELF) -> int:
    """Return the largest memory in bytes that a process has had in use.

    Args:
        who: `resource.RUSAGE_SELF` for this process, `RUSAGE_CHILDREN` for the largest of those that have ended.
    """
    peak = resource.getrusage(who).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak  # macOS counts bytes, other systems KiB
