"""The type of a metric, with its name, unit, direction and measure, and the types of scores that a measure returns."""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from ha2g_jax.metrics.uncertainty import Estimate

Statistic = Callable[[np.ndarray], float]
"""A score as a function of how often each recording is drawn, (recordings,); ones give the score itself."""

Score = Statistic | Estimate | float | None
"""A `Statistic` gets its interval from the bootstrap, an `Estimate` has a standard error, a number has neither."""

Direction = Literal["higher", "lower", "none"]

# Groups of columns, in the order of the table.
BEATS = "Beats against the speech"
LIKENESS = "Motion as a whole"
MOVEMENT = "Movement"
HANDS = "Hands and head"
GIVEAWAY = "What gives it away: area under the curve of a linear classifier on 5 s (0.5: cannot be told apart)"
RECONSTRUCTION = "Errors of reconstruction, not quality"
LEGACY = "Legacy rules (legacy_v1), for comparison with old tables only"
KNOWN_CAUSES = "Known causes"
TAKES = "Takes for one speech against those of the teacher, by the wrists"
PROBE = "Word class from frozen f_high at word onsets, by a linear probe"
BEAT2 = "Protocol BEAT2: all joints of SMPL-X, 30 frames per second"
RECORDING = "Strokes of the hands against the onsets of the recording"
RECORDING_HANDS = "Hands and head, to be held against a person's"

Section = Literal["rows", "legacy_v1", "known_causes", "recording", "beat2"]


@dataclasses.dataclass(frozen=True)
class Metric:
    """A registered metric: one column of the table of `ha2g evaluate`.

    Attributes:
        name: key of the score in the results.
        title: text above the column, without the unit.
        unit: physical unit of the value; "" for a number without one.
        direction: direction that is usually considered better, or "none". It is never printed, because a value is good
            when it is close to that of ground truth. A sanity row that goes further in that direction than ground truth
            shows that the metric does not measure quality, and is reported.
        group: heading of the part of the table that holds the column.
        digits: number of digits after the decimal point.
        measure: function that maps one row of the table to the score, None if the row has none. The argument is a
            `row.Row`; for known causes it is a `causes.CauseRow`, for a recording a `strokes.RecordingRow`, for the
            protocol BEAT2 a `rests.Beat2Row`.
        section: part of the results that holds the score.
        draws: function that maps a row to the values (n,) of random draws, None if the row has none; their mean and
            standard deviation are shown instead of the value.
        halves: function that maps the row of ground truth to the values (n,) of one half of the recordings compared
            with the other, None if there are none.
        is_paired: whether the difference between two methods is shown.
    """

    name: str
    title: str
    unit: str
    direction: Direction
    group: str
    digits: int
    measure: Callable[[Any], Score]
    section: Section = "rows"
    draws: Callable[[Any], np.ndarray | None] | None = None
    halves: Callable[[Any], np.ndarray | None] | None = None
    is_paired: bool = False

    @property
    def heading(self) -> str:
        """Title and unit, as printed above the column."""
        return f"{self.title}{'' if self.unit.startswith('/') else ' '}{self.unit}".strip()
