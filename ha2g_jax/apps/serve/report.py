"""What a worker tells its parent."""

import json
from typing import NamedTuple


class Report(NamedTuple):
    """State of a worker.

    Attributes:
        is_ready: whether it takes connections.
        received: connections that it has received so far.
        open: connections that are open.
        is_full: whether all its places for streams are taken.
        error: reason for which it cannot begin, one line.
    """

    is_ready: bool = False
    received: int = 0
    open: int = 0
    is_full: bool = False
    error: str | None = None

    def line(self) -> bytes:
        """Return the report as a line of JSON."""
        return json.dumps(self).encode() + b"\n"

    @classmethod
    def parse(cls, line: bytes) -> "Report":
        """Return the report of a line."""
        return cls(*json.loads(line))
