"""The study of look-aheads: the compared models, the look-aheads at which they are scored, and the verdicts."""

import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tables.claims import HELD, NOT_HELD, UNDECIDED, Measured, Spread, combine, interval, paired
from tables.plan import Plan, Request, plan_rows
from tables.workdirs import Run, is_finished, read_stored, scores_file

Scores = Mapping[str, Any]  # of one run at one look-ahead, as `scores.score_look_aheads` stores them
Curves = Mapping[str, Mapping[int | None, Mapping[int, Scores]]]  # setting -> look-ahead -> seed -> scores

TABLE = "latency"  # of a request

# Frames; None hears the whole file, as `Model.generate` does.
LOOK_AHEADS: tuple[int | None, ...] = (0, 1, 2, 3, 5, 8, 15, None)
HOP = 1  # frames generated in one run of a stream
EVERY = 2  # every second clip is scored, one of each recording of Talk, because streams take long

HIDDEN, WHOLE = "hidden ends", "whole windows"
# Name of a setting -> how it differs from HA2G.
SETTINGS: dict[str, Mapping[str, Any]] = {
    HIDDEN: {"data.lookahead": 0.5},  # of this fraction of the training windows the end of the speech is hidden
    WHOLE: {},
}

# Names of the scores, as `scores` stores them.
GAIN, F1, RECALL, FLOOR, ABOVE_FLOOR = "beat_f1_gain", "beat_f1", "semantic_recall", "semantic_floor", "above_floor"
JERK, BEATS = "jerk_ratio", "beats_per_second"
PRIMARY = (GAIN, ABOVE_FLOOR)

_EVALUATION_VERSION = 1  # version of what `scores` measures; a higher number makes it compute all scores again


def plan_settings(request: Request) -> Plan:
    """Plan the runs of each setting, one for each seed.

    Raises:
        UserError: there is no such corpus or setting.
    """
    return plan_rows(request, {name: ("ha2g", changes) for name, changes in SETTINGS.items()})


def scores_path(run: Run, plan: Plan, split: str, look_ahead: int | None) -> pathlib.Path | None:
    """Return the path of the scores of a run at one of `LOOK_AHEADS`, or None without a checkpoint."""
    return scores_file(run, "look-ahead", [_EVALUATION_VERSION, split, EVERY, look_ahead, HOP, plan.digest])


def read_scores(run: Run, plan: Plan, split: str) -> Mapping[int | None, Scores] | None:
    """Return the scores of a finished run by look-ahead, or None where one is missing."""
    found = {at: read_stored(scores_path(run, plan, split, at)) for at in LOOK_AHEADS} if is_finished(run) else {}
    whole = {at: scores for at, scores in found.items() if scores is not None}
    return whole if len(whole) == len(LOOK_AHEADS) else None


def title(look_ahead: int | None) -> str:
    """Return the name of a look-ahead in tables and charts."""
    return "file" if look_ahead is None else str(look_ahead)


MODEL_SCORES, TRUTH_SCORES = "model_scores", "truth_scores"


def measured(scores: Scores, name: str, row: str = MODEL_SCORES) -> Measured | None:
    """Look up a score of one run, None where it is undefined."""
    found = scores[row].get(name)
    if found is None or found["value"] is None or None in found["without"]:
        return None
    return Measured(found["value"], np.array(found["without"], float))


def level(scores: Mapping[int, Scores], name: str, row: str = MODEL_SCORES) -> Spread | None:
    """Compute the mean of a score over seeds, None where no seed has it.

    The truth is the same for all seeds, and its value has no interval.
    """
    found = [each for one in scores.values() if (each := measured(one, name, row)) is not None]
    if found and row == TRUTH_SCORES:
        return Spread(found[0].value, None, None, len(found))
    return interval(combine(found)) if found else None


def difference(first: Mapping[int, Scores], second: Mapping[int, Scores], name: str) -> Spread | None:
    """Compute the mean of first minus second, by seed on the same recordings, over common seeds; None without any."""
    pair = ({seed: found for seed, one in each.items() if (found := measured(one, name))} for each in (first, second))
    found = paired(*pair)
    return None if found is None else interval(found)


def is_better(spread: Spread | None) -> str:
    """Return whether a difference shows that the first is better: held, not held (it is worse) or undecided."""
    if spread is None or spread.low is None or spread.high is None or spread.low <= 0 <= spread.high:
        return UNDECIDED
    return HELD if spread.low > 0 else NOT_HELD


def is_no_worse(spread: Spread | None, margin: float) -> str:
    """Return whether a difference shows that the first is worse by less than a margin: held, not held or undecided."""
    if spread is None or spread.low is None or spread.high is None:
        return UNDECIDED
    return HELD if spread.low > -margin else NOT_HELD if spread.high < -margin else UNDECIDED


def all_of(verdicts: Sequence[str]) -> str:
    """Return the verdict on several claims together: held if all are, not held if one is not."""
    if NOT_HELD in verdicts:
        return NOT_HELD
    return HELD if all(verdict == HELD for verdict in verdicts) else UNDECIDED


def losses(curve: Mapping[int | None, Mapping[int, Scores]], name: str) -> dict[int | None, Spread | None]:
    """Compute by how much a score of a setting is lower at each look-ahead than with the whole file."""
    return {at: difference(curve.get(None, {}), curve.get(at, {}), name) for at in LOOK_AHEADS if at is not None}


def smallest_within(found: Mapping[int | None, Spread | None], margin: float) -> tuple[int | None, int | None]:
    """Return the smallest look-aheads with a loss of at most a margin: in the mean, and with the whole interval.

    Each is None where there is none; the losses are those of `losses`, in ascending order of look-aheads.
    """
    there = {at: spread for at, spread in found.items() if spread is not None}
    means = [at for at, spread in there.items() if spread.mean <= margin]
    whole = [at for at, spread in there.items() if spread.high is not None and spread.high <= margin]
    return means[0] if means else None, whole[0] if whole else None


def first_above_zero(curve: Mapping[int | None, Mapping[int, Scores]], name: str) -> int | None:
    """Return the smallest look-ahead in frames from which on the interval of a score is above 0; None without one."""
    smallest = None
    for at in reversed([each for each in LOOK_AHEADS if each is not None]):
        spread = level(curve.get(at, {}), name)
        if spread is None or spread.low is None or spread.low <= 0:
            break
        smallest = at
    return smallest
