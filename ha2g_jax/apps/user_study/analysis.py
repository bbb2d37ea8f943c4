"""The analysis of a user study: from answer files to numbers of JSON."""

import itertools
import math
import pathlib
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from ha2g_jax.apps.user_study import bradley_terry
from ha2g_jax.apps.user_study.answers import Choices, Ratings, choices_of, ratings_of, read_answers
from ha2g_jax.apps.user_study.design import KINDS, MISMATCH, PREFERENCE, Key, read_key
from ha2g_jax.apps.user_study.estimates import LEVEL, CrossedEstimate, Share, agreement, mean, share, system_differences
from ha2g_jax.errors import require
from ha2g_jax.evaluation.evaluate import json_number
from ha2g_jax.metrics.uncertainty import holm


def analyse(paths: Sequence[pathlib.Path], study: pathlib.Path) -> dict[str, Any]:
    """Read answer files, and folders of them, and compute all statistics of a study, whose folder has `key.json`.

    Returns:
        "study", "title", "level"; "participants", "excluded" and "answers" (what was counted); "opinion", "preference"
        and "mismatch", each None without such answers; "agreement"; "comments". Undefined numbers are None, and an
        infinite bound is "inf" or "-inf".

    Raises:
        UserError: there is no key or no answer file, or the package of the extra report is missing.
    """
    require("choix", "report", by="the analysis of a study")
    key = read_key(study)
    answers = read_answers(paths, key)
    kept = answers.participants
    ratings = ratings_of(kept, key)
    preferences, mismatches = (choices_of(kept, key, kind) for kind in (PREFERENCE, MISMATCH))
    kinds = Counter(answer.item.kind for one in kept for answer in one.answers)
    return {
        "study": key.study,
        "title": key.title,
        "level": LEVEL,
        "participants": [{"participant": one.id, "file": one.file, "answers": len(one.answers)} for one in kept],
        "excluded": [exclusion._asdict() for exclusion in answers.excluded],
        "answers": {kind: kinds[kind] for kind in KINDS if kinds[kind]},
        "opinion": _opinion(ratings, key) if len(ratings.scores) else None,
        "preference": _preference(preferences, key) if len(preferences.outcome) else None,
        "mismatch": _mismatch(mismatches, key) if len(mismatches.outcome) else None,
        "agreement": _agreement(ratings, preferences, mismatches, key),
        "comments": [{"participant": one.id, "text": one.comments} for one in kept if one.comments.strip()],
    }


def _opinion(ratings: Ratings, key: Key) -> dict[str, Any]:
    found: dict[str, Any] = {"points": list(key.points), "scales": {}}
    for scale, scores in zip(key.scales, ratings.scores.T, strict=True):
        means = {}
        for at, name in enumerate(ratings.systems):
            mine = ratings.system == at
            estimate = mean(scores[mine], ratings.participant[mine], ratings.clip[mine])
            low, high = np.clip([estimate.low, estimate.high], *key.points)
            means[name] = {**_json(estimate._replace(low=low, high=high), "error"), "ratings": int(mine.sum())}
        found["scales"][scale] = {"means": means, "differences": []}
        if len(ratings.systems) > 1:
            columns = (ratings.participant, ratings.clip, ratings.system)
            estimates = system_differences(scores, *columns, len(ratings.systems))
            rows = _rows(estimates, ratings.systems, "error", "p")
            found["scales"][scale]["differences"] = _with_holm(rows)
    return found


def _preference(choices: Choices, key: Key) -> dict[str, Any]:
    rows = []
    for first, second in itertools.combinations(range(len(key.systems)), 2):
        mine = choices.where((choices.first == first) & (choices.second == second))
        if len(mine.outcome):
            names = {"first": key.systems[first], "second": key.systems[second]}
            rows.append({**names, **_share(share(mine))})
    found: dict[str, Any] = {"pairs": _with_holm(rows), "strengths": {}, "differences": [], "is_connected": False}
    decided = choices.where(choices.outcome != 0)
    if not len(decided.outcome):
        return found
    result = bradley_terry.estimate(decided, len(key.systems))
    names = [key.systems[index] for index in result.systems]
    for at, name in enumerate(names):
        one = CrossedEstimate(*(np.asarray(column)[at] for column in result.strengths))
        elo = bradley_terry.ELO_CENTRE + bradley_terry.ELO_PER_LOGIT * one.value
        found["strengths"][name] = {**_json(one, "error"), "elo": _number(elo), "is_finite": bool(result.finite[at])}
    return {
        **found,
        "differences": _rows(result.differences, names, "error"),
        "is_connected": result.is_connected,
        "missing": [name for name in key.systems if name not in names],
    }


def _mismatch(choices: Choices, key: Key) -> dict[str, Any]:
    rows = []
    for at, name in enumerate(key.systems):
        mine = choices.where(choices.first == at)
        if len(mine.outcome):
            rows.append({"system": name, **_share(share(mine))})
    return {"systems": _with_holm(rows)}


def _agreement(ratings: Ratings, preferences: Choices, mismatches: Choices, key: Key) -> dict[str, Any]:
    columns: dict[str, tuple[Ratings | Choices, np.ndarray]] = {}
    for scale, scores in zip(key.scales, ratings.scores.T, strict=True):
        columns[scale] = (ratings, scores)
    columns |= {"preference": (preferences, preferences.outcome), "mismatch": (mismatches, mismatches.outcome)}
    found = {}
    for name, (rows, values) in columns.items():
        if len(values):
            kappa = agreement(rows.participant, rows.clip, rows.item, values)
            _, counts = np.unique(rows.item, return_counts=True)
            found[name] = {**_json(kappa), "items": int((counts > 1).sum()), "answers_per_item": float(counts.mean())}
    return found


def _share(found: Share) -> dict[str, Any]:
    counts = {name: getattr(found, name) for name in ("first", "equal", "second")}
    numbers = {name: _number(value) for name, value in found._asdict().items() if name not in counts}
    return {"choices": counts, **numbers}


def _rows(estimates: CrossedEstimate, names: Sequence[str], *fields: str) -> list[dict[str, Any]]:
    """Return a row for each pair of systems, "first" minus "second"."""
    return [
        {"first": first, "second": second, **_json(CrossedEstimate(*(column[number] for column in estimates)), *fields)}
        for number, (first, second) in enumerate(itertools.combinations(names, 2))
    ]


def _json(estimate: CrossedEstimate, *fields: str) -> dict[str, Any]:
    return {name: _number(getattr(estimate, name)) for name in ("value", "low", "high", *fields)}


def _number(value: Any) -> float | str | None:
    """Return a number for JSON, "inf" or "-inf" if it is infinite, None if it is undefined."""
    return str(float(value)) if math.isinf(value) else json_number(float(value))


def _with_holm(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Add "p_holm" to rows: the p-values after the correction of Holm (1979) for all rows that have one."""
    corrected = iter(holm([row["p"] for row in rows if row["p"] is not None]))
    return [{**row, "p_holm": json_number(math.nan if row["p"] is None else next(corrected))} for row in rows]
