"""The parser of the commands: a mistake is answered with the usage of the command that it was made in."""

import argparse
from collections.abc import Sequence
from typing import Any

from ha2g_jax.errors import UserError
from ha2g_jax.limits import MAX_SEED


class Parser(argparse.ArgumentParser):
    """A parser whose commands report unknown arguments themselves, and not through the parser of `ha2g`."""

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> tuple[Any, list[str]]:  # type: ignore[override]
        """Parse arguments, all of which must be known.

        Args:
            args: arguments; by default those of this process.
            namespace: object that takes the values.

        Returns:
            The namespace, and no further arguments.
        """
        values, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unknown arguments: {' '.join(unknown)}; see {self.prog} --help")
        return values, unknown


def read_seed(text: str) -> int:
    """Parse a seed of the command line.

    Args:
        text: a whole number.

    Returns:
        The number, from 0 to `MAX_SEED`.

    Raises:
        UserError: the text is another one.
    """
    if not (text.isdecimal() and len(text) <= len(str(MAX_SEED)) and int(text) <= MAX_SEED):
        raise UserError(f"the seed is {text[:40]!r}; give a whole number from 0 to {MAX_SEED}")
    return int(text)


def add_reading(command: Any, *, joint_map: str | None = "auto") -> None:
    """Add the options that reading motion of others may need.

    Args:
        command: parser or group of a command.
        joint_map: default of `--joint-map`.
    """
    command.add_argument(
        "--joint-map",
        default=joint_map,
        metavar="MAP",
        help="joint names of BVH files: auto, mixamo, zeroeggs, beat, genea, ha2g or a YAML file (default: auto)",
    )
    command.add_argument(
        "--source-fps", type=float, metavar="FPS", help="frames per second of files that do not say it"
    )
