"""Settings in which runs differ, and the lines of charts: runs whose configs differ only in the seed are one line."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

from ha2g_jax.train.report.runs import Run

SEED = "seed"
ABSENT = "-"  # shown for a setting that a run does not have

_MOST_SETTINGS = 3  # settings that a label names; lines with more differences are named after their runs


class Line(NamedTuple):
    """Runs that are one line of a chart.

    Attributes:
        label: short text that tells the line from the others.
        runs: one run, or several with distinct seeds and otherwise equal configs.
    """

    label: str
    runs: tuple[Run, ...]


def differing(runs: Sequence[Run]) -> list[str]:
    """Return the settings in which runs differ, in the order of the configs; damaged runs are passed over.

    Args:
        runs: runs to compare.
    """
    readable = [run.settings for run in runs if run.settings]
    names = dict.fromkeys(name for settings in readable for name in settings)
    return [name for name in names if len({_key(settings.get(name, ABSENT)) for settings in readable}) > 1]


def common_differing(runs: Sequence[Run]) -> list[str]:
    """Return the settings of `differing` that all runs have, so that the parts of a method are told by its name."""
    readable = [run.settings for run in runs if run.settings]
    return [name for name in differing(runs) if all(name in settings for settings in readable)]


def short_names(names: Sequence[str]) -> dict[str, str]:
    """Return for each dotted name its shortest ending that no other name has.

    Args:
        names: distinct dotted names.
    """
    short = {}
    for name in names:
        parts = name.split(".")
        endings = [".".join(parts[-count:]) for count in range(1, len(parts) + 1)]
        others = [f".{other}" for other in names if other != name]
        short[name] = next((end for end in endings if not any(other.endswith(f".{end}") for other in others)), name)
    return short


def value_text(settings: dict[str, Any], name: str) -> str:
    """Return the value of a setting as text, `ABSENT` where the config does not have it."""
    value = settings.get(name, ABSENT)
    if isinstance(value, list):
        return f"({','.join(map(str, value))})"
    return f"{value:g}" if type(value) is float else str(value)


def make_lines(runs: Sequence[Run]) -> list[Line]:
    """Group runs into lines.

    Runs are one line if their configs differ in the seed and in nothing else. If two of them have the same seed, they
    differ in something that the config does not say, such as the code, and each run is a line.

    Args:
        runs: runs; damaged ones are passed over.
    """
    groups: dict[str, list[Run]] = {}
    for run in runs:
        if run.settings:
            others = {name: value for name, value in run.settings.items() if name != SEED}
            groups.setdefault(_key(others), []).append(run)
    parts: list[tuple[Run, ...]] = []
    for group in groups.values():
        seeds = [_key(run.settings.get(SEED)) for run in group]
        parts += [tuple(group)] if len(set(seeds)) == len(seeds) else [(run,) for run in group]
    return [Line(label, part) for label, part in zip(_labels(parts), parts, strict=True)]


def _labels(parts: Sequence[tuple[Run, ...]]) -> list[str]:
    names = [name for name in common_differing([part[0] for part in parts]) if name != SEED]
    short = short_names(names)
    texts = [", ".join(f"{short[name]}={value_text(part[0].settings, name)}" for name in names) for part in parts]
    if not 0 < len(names) <= _MOST_SETTINGS or len(set(texts)) < len(texts):
        texts = [part[0].name + (f" and {len(part) - 1} more" if part[1:] else "") for part in parts]
    return texts


def _key(value: Any) -> str:
    return json.dumps(value, sort_keys=True)
