"""Settings of a config that are one or some of a few names."""

from collections.abc import Sequence

from ha2g_jax.errors import UserError


def choice(field: str, value: str, choices: Sequence[str]) -> str:
    """`value`, if it is one of `choices`.

    Raises:
        UserError: it is not; the line names the field of the config.
    """
    if value not in choices:
        raise UserError(f"config.{field} is {value!r}, expected one of {', '.join(choices)}: set --config.{field}")
    return value


def some_of(field: str, values: Sequence[str], choices: Sequence[str]) -> tuple[str, ...]:
    """`values` in the order of `choices`, if they are one or more of them.

    Raises:
        UserError: they are not.
    """
    if not values or isinstance(values, str) or set(values) - set(choices):
        raise UserError(f"config.{field} is {values!r}, expected one or more of {', '.join(choices)}")
    return tuple(name for name in choices if name in values)
