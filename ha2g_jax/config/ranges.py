"""Ranges of the values of settings: a description of the values, and a function that checks them."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ha2g_jax.limits import MAX_LAYERS, MAX_SETTING


class Range(NamedTuple):
    """Values that a setting may have.

    Attributes:
        expected: the values in words, such as "a whole number from 1 to 4".
        contains: function that tells whether a value is one of them.
    """

    expected: str
    contains: Callable[[Any], bool]


TEXT = Range("a text", lambda value: isinstance(value, str))
FLAG = Range("True or False", lambda value: isinstance(value, bool))
POSITIVE = Range("a number above 0", lambda value: _is_number(value) and 0 < value <= MAX_SETTING)


def whole(least: int, most: int = MAX_SETTING) -> Range:
    """Return the range of whole numbers from `least` to `most`."""
    return Range(
        f"a whole number from {least} to {most}", lambda value: _is_number(value, int) and least <= value <= most
    )


def number(least: float, most: float = MAX_SETTING) -> Range:
    """Return the range of numbers from `least` to `most`."""
    return Range(f"a number from {least} to {most}", lambda value: _is_number(value) and least <= value <= most)


def below(bound: float) -> Range:
    """Return the range of numbers from 0 to below `bound`."""
    return Range(f"a number from 0 to below {bound:g}", lambda value: _is_number(value) and 0 <= value < bound)


def one_of(*names: str) -> Range:
    """Return the range of a setting that is one of some names."""
    return Range(f"one of {', '.join(names)}", lambda value: isinstance(value, str) and value in names)


def some_of(*names: str) -> Range:
    """Return the range of a setting that is one or more of some names, each once, in any order."""
    one = one_of(*names)
    return Range(
        f"one or more of {', '.join(names)}, each once",
        lambda values: _is_list(values) and all(map(one.contains, values)) and 0 < len(values) == len({*values}),
    )


def several(item: Range, count: int | None = None, least: int = 0) -> Range:
    """Return the range of lists of `count` values, or of `least` to `MAX_LAYERS`, each in the range `item`."""
    expected = f"{count}" if count else f"{least} to {MAX_LAYERS}"
    low, high = (count, count) if count else (least, MAX_LAYERS)
    return Range(
        f"a list of {expected}, each {item.expected}",
        lambda values: _is_list(values) and low <= len(values) <= high and all(map(item.contains, values)),
    )


def so_that(base: Range, expected: str, contains: Callable[[Any], bool]) -> Range:
    """Return the range of the values in `base` for which `contains` holds too; `expected` describes all of it."""
    return Range(expected, lambda value: base.contains(value) and contains(value))


def _is_number(value: Any, kind: type | tuple[type, ...] = (int, float)) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)


def _is_list(values: Any) -> bool:
    return isinstance(values, Sequence) and not isinstance(values, str)
