"""Plan of the study of look-aheads: the models that are compared, what they are scored at, and where scores are."""

import pathlib
from collections.abc import Mapping
from typing import Any

from tables.plan import Run, hashed_path, plan_row
from tables.request import Request

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

EVALUATION_VERSION = 1  # of what `scores` measures; a higher number makes all scores anew


def plan_settings(request: Request, corpus: pathlib.Path) -> dict[str, tuple[Run, ...]]:
    """Plan the runs of each setting, one for each seed; nothing is written.

    Args:
        request: request of the user; its table is not used.
        corpus: folder of the corpus.

    Raises:
        UserError: there is no such corpus, or a seed is given twice.
    """
    return {name: plan_row(request, corpus, "ha2g", changes, name) for name, changes in SETTINGS.items()}


def scores_path(run: Run, corpus: pathlib.Path, split: str, look_ahead: int | None) -> pathlib.Path | None:
    """Return the path of the scores of a run at one look-ahead, whose name has a hash of all that they depend on.

    Args:
        run: run that is scored.
        corpus: folder of the corpus.
        split: split that is scored.
        look_ahead: one of `LOOK_AHEADS`.

    Returns:
        The path, or None without a checkpoint.
    """
    causes = [EVALUATION_VERSION, split, EVERY, look_ahead, HOP]
    return hashed_path(run, "look-ahead", causes, (corpus / "dataset.json",))


def title(look_ahead: int | None) -> str:
    """Return the name of a look-ahead in tables and charts."""
    return "file" if look_ahead is None else str(look_ahead)
