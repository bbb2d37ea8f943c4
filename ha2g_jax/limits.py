"""Limits of inputs from outside; docs/limits.md states them, and a test compares the two.

Each is far above what real recordings need, and low enough that an input within all of them is read in seconds and in
less than 2 GiB of memory.
"""

MAX_NAME_LENGTH = 200
"""Letters of a path that a message shows."""

MAX_JSON_DEPTH = 64
"""Objects and lists inside one another in a JSON document."""
