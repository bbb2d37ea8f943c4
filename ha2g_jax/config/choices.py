"""Check settings whose value is one or several of a few names."""

import reprlib
from collections.abc import Sequence

from ha2g_jax.errors import UserError

# Networks as the paper describes them, or as the authors' public code has them (docs/released_weights.md).
ARCHITECTURES = ("paper", "release")


def choice(field: str, value: str, choices: Sequence[str]) -> str:
    """Return `value` if it is one of `choices`.

    Args:
        field: dotted name of the setting.
        value: value of the setting.
        choices: allowed values.

    Raises:
        UserError: the value is not one of `choices`.
    """
    if value not in choices:
        expected = ", ".join(choices)
        raise UserError(f"config.{field} is {reprlib.repr(value)}, expected one of {expected}: set --config.{field}")
    return value


def some_of(field: str, values: Sequence[str], choices: Sequence[str]) -> tuple[str, ...]:
    """Return `values` in the order of `choices` if they are one or more of these.

    Args:
        field: dotted name of the setting.
        values: value of the setting.
        choices: allowed values.

    Raises:
        UserError: there are no values, or one is not in `choices`.
    """
    if not values or isinstance(values, str) or set(values) - set(choices):
        raise UserError(f"config.{field} is {reprlib.repr(values)}, expected one or more of {', '.join(choices)}")
    return tuple(name for name in choices if name in values)
