"""What gives motion away: how well a linear classifier tells a system from a person by features of 5 s of motion.

The value is the area under the ROC curve on recordings that the classifier has not seen: at 0.5 they cannot be told
apart, at 1 always. There is a value for each group of features, so that they show how motion differs from a person's.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.metrics.beats.strokes import stroke_beats
from ha2g_jax.metrics.beats.times import minima
from ha2g_jax.metrics.hands import (
    MOVING,
    UpperBody,
    both_moving,
    hand_distances,
    one_moving,
    row_bodies,
    spread_of_directions,
)
from ha2g_jax.metrics.metric import GIVEAWAY, Metric, Score
from ha2g_jax.metrics.row import Row, mean_by_recording
from ha2g_jax.metrics.uncertainty import Estimate, jackknife

WINDOW, HOP = 5.0, 2.5  # length of a window and distance to the next, in seconds
MAX_FOLDS = 20  # parts that the recordings are divided into; each is left out once
BLOCKS = 5  # parts of the time of one recording, if there is only one
BANDS = (0.2, 0.6, 1.2, 2.4)  # Hz, lower edges of the bands of the speed's spectrum

_FEWEST = 4  # windows that a classifier is trained on
_SMALL = 1e-3  # metres, m/s, degrees: smaller quantities are replaced by this in logarithms
_AXES = ("lateral", "vertical", "depth")
_OUTWARD = np.array([[1.0, 1, 1], [-1, 1, 1]])  # for each hand, so that x points away from the body

Features = dict[str, float]


def bimanual(body: UpperBody) -> Features:
    """Return how the two hands move together."""
    speeds, distances = body.speeds, hand_distances(body) / 100
    mirrored = np.diff(body.wrists, axis=0) * _OUTWARD
    means = np.sort(speeds.mean(axis=0))
    together = {f"correlation, {axis}": _correlation(*mirrored[..., place].T) for place, axis in enumerate(_AXES)}
    return {
        "correlation of speeds": _correlation(*speeds.T),
        **together,
        "both moving": both_moving(body),
        "one moving": one_moving(body),
        "distance": _log(distances.mean()),
        "distance sd": _log(distances.std()),
        "slower over faster": _log(means[0]) - _log(means[1]),
    }


def extent(body: UpperBody) -> Features:
    """Return how far each wrist moves in each direction."""
    places = _to_shoulders(body)
    ranges = np.quantile(places, 0.95, axis=0) - np.quantile(places, 0.05, axis=0)
    return _of_hands("sd", _log(places.std(axis=0))) | _of_hands("range", _log(ranges))


def place(body: UpperBody) -> Features:
    """Return where the wrists are, relative to the middle of the shoulders."""
    places = _to_shoulders(body) * _OUTWARD
    heights = {
        f"{name} height": float(np.quantile(places[..., 1].mean(axis=1), quantile))
        for name, quantile in (("upper", 0.05), ("lower", 0.95))
    }
    return _of_hands("mean", places.mean(axis=0)) | heights


def rhythm(body: UpperBody) -> Features:
    """Return how often and how regularly the hands move."""
    speed = body.speeds.mean(axis=1)
    intervals = np.diff(minima(speed).sample) / body.fps
    power = np.square(np.abs(np.fft.rfft((speed - speed.mean()) * np.hanning(len(speed)))))
    bands = np.digitize(np.fft.rfftfreq(len(speed), 1 / body.fps), BANDS)
    total = power.sum() + 1e-9
    shares = {
        f"share from {edge:g} Hz": _log(power[bands == number].sum() / total)
        for number, edge in enumerate(BANDS, start=1)
    }
    return {
        "strokes a second": len(stroke_beats(body.wrists, body.fps)) / WINDOW,
        "interval of minima": float(intervals.mean()) if len(intervals) else WINDOW,
        "interval sd": float(intervals.std()) if len(intervals) else 0.0,
        "speed sd over mean": float(speed.std() / (speed.mean() + _SMALL)),
        **shares,
    }


def direction(body: UpperBody) -> Features:
    """Return where the hands move at the fastest moment of each stroke in any direction."""
    velocities = np.diff(body.wrists, axis=0) * body.fps * _OUTWARD
    strokes = []
    for side in (0, 1):
        speed = body.speeds[:, side]
        fastest = minima(-speed).sample
        fastest = fastest[speed[fastest] > MOVING]
        strokes.append(velocities[fastest, side] / speed[fastest, None])
    units = np.concatenate([*strokes, np.zeros((1, 3))])[: max(1, sum(map(len, strokes)))]
    return {f"share {axis}": float(np.abs(units[:, i]).mean()) for i, axis in enumerate(_AXES)} | {
        f"mean {way}": float(units[:, i].mean()) for i, way in enumerate(("outward", "downward", "backward"))
    }


def head_and_trunk(body: UpperBody) -> Features:
    """Return how far head and trunk turn and lean, and how fast."""
    across = body.shoulders[:, 0] - body.shoulders[:, 1]
    parts = {"head": body.head, "trunk": body.trunk, "shoulders": across}
    features = {f"{name} sd": _log(spread_of_directions(vectors)) for name, vectors in parts.items()}
    features["turn sd"] = _log(np.degrees(np.arctan2(across[:, 2], across[:, 0]).std()))
    for name, vectors in parts.items():
        sizes, moved = np.linalg.norm(vectors[1:], axis=-1), np.linalg.norm(np.diff(vectors, axis=0), axis=-1)
        steps = np.divide(moved, sizes, out=np.zeros_like(moved), where=sizes > 1e-9)  # without length: no direction
        features[f"{name} speed"] = _log(np.degrees(steps.mean()) * body.fps)
    return features


def smoothness(body: UpperBody) -> Features:
    """Return the jerk of the wrists, and how it relates to acceleration and speed."""
    sizes = []
    for order in (1, 2, 3):
        differences = np.diff(body.wrists, n=order, axis=0) * body.fps**order
        sizes.append(np.sort(_log(np.linalg.norm(differences, axis=-1).mean(axis=0))))
    speed, acceleration, jerk = sizes
    return {
        f"{name} of the {which} hand": float(values[hand])
        for name, values in (
            ("jerk", jerk),
            ("jerk over acceleration", jerk - acceleration),
            ("acceleration over speed", acceleration - speed),
        )
        for hand, which in enumerate(("lesser", "greater"))
    }


GROUPS: dict[str, Callable[[UpperBody], Features]] = {
    "bimanual": bimanual,
    "extent": extent,
    "place": place,
    "rhythm": rhythm,
    "direction": direction,
    "head and trunk": head_and_trunk,
    "smoothness": smoothness,
}
ALL = "all"


def _log(values: Any) -> Any:
    return np.log(np.maximum(values, _SMALL))


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    first, second = first - first.mean(), second - second.mean()
    return float(first @ second / (np.sqrt(first @ first * (second @ second)) + 1e-9))


def _to_shoulders(body: UpperBody) -> np.ndarray:
    return body.wrists - body.shoulders.mean(axis=1, keepdims=True)


def _of_hands(name: str, values: np.ndarray) -> Features:
    """Name values (hands, axes) by axis, and by whether a hand has the smaller or the larger value."""
    values = np.sort(values, axis=0)
    return {
        f"{axis} {name}, {which}": float(values[hand, number])
        for number, axis in enumerate(_AXES)
        for hand, which in enumerate(("lesser", "greater"))
    }


class Windows(NamedTuple):
    """Features (n, features) of windows, and the clip, the recording and the start in seconds (n,) of each."""

    features: np.ndarray
    clips: np.ndarray
    recordings: np.ndarray
    starts: np.ndarray


def columns(group: str) -> np.ndarray:
    """Return the indices of the features of a group, or of `ALL`."""
    names = feature_names()
    return np.array([index for index, (owner, _) in enumerate(names) if group in (owner, ALL)])


@functools.cache
def feature_names() -> tuple[tuple[str, str], ...]:
    """Return group and name of each feature, in order."""
    hands, body = np.ones((75, 2, 3)) * ((1,), (-1,)), np.ones((75, 3))
    sample = UpperBody(hands, hands, body, body, 15.0)
    return tuple((group, name) for group, function in GROUPS.items() for name in function(sample))


def windows_of(bodies: Sequence[UpperBody], clips: np.ndarray, recordings: np.ndarray) -> Windows:
    """Return the windows of motions, given the index of the clip and of the recording of each motion, (n,)."""
    features, owners, starts = [], [], []
    for number, body in enumerate(bodies):
        length, hop = round(WINDOW * body.fps), round(HOP * body.fps)
        for start in range(0, len(body.wrists) - length + 1, hop):
            window = body.cut(start, start + length)
            features.append([value for function in GROUPS.values() for value in function(window).values()])
            owners.append(number)
            starts.append(start / body.fps)
    owner = np.array(owners, int)
    return Windows(np.array(features), clips[owner], recordings[owner], np.array(starts))


class Areas(NamedTuple):
    """Areas under the ROC curve (n,) of recordings, with the number of windows and the index (n,) of each."""

    values: np.ndarray
    windows: np.ndarray
    recordings: np.ndarray


def held_out_areas(person: Windows, system: Windows, group: str = ALL) -> Areas | None:
    """Return the areas by which a system is told from a person in recordings that the classifier has not seen.

    The classifier is linear discriminant analysis with shrinkage, trained without one recording, or one of `MAX_FOLDS`
    parts of many, and tested on it. With only one recording, `BLOCKS` parts of its time replace the recordings, and
    windows that overlap the tested block are not trained on. None if there are too few windows.
    """
    sides = (person, system)
    units, used, found = [_unit_of(side, person) for side in sides], columns(group), []
    for fold in np.unique(units[0] % MAX_FOLDS):
        is_tested = units[0] % MAX_FOLDS == fold
        trained = [~_near(side, person, is_tested) for side in sides]
        if not all(mask.any() for mask in trained) or sum(mask.sum() for mask in trained) < _FEWEST:
            continue
        weights = discriminant(*(side.features[mask][:, used] for side, mask in zip(sides, trained, strict=True)))
        for unit in np.unique(units[0][is_tested]):
            first, second = (
                side.features[owner == unit][:, used] @ weights for side, owner in zip(sides, units, strict=True)
            )
            if len(second):
                found.append((area_under_curve(first, second), len(first), unit))
    return Areas(*np.array(found).T) if len(found) > 1 else None


def told_apart(person: Windows, system: Windows, group: str = ALL) -> Estimate | None:
    """Return the mean of `held_out_areas`, weighted by windows, and its standard error by the jackknife."""
    areas = held_out_areas(person, system, group)
    if areas is None:
        return None
    return jackknife(
        np.stack([areas.values, areas.windows], axis=1),
        lambda rows: float(np.average(rows[:, 0], weights=rows[:, 1])),
        areas.recordings,
    )


def _unit_of(windows: Windows, person: Windows) -> np.ndarray:
    """Return the unit that each window is left out with: its recording, or a block of time of the only recording."""
    if _has_many(person):
        return windows.recordings
    keys = np.unique(np.stack([person.clips, person.starts], axis=1), axis=0).tolist()
    own = np.stack([windows.clips, windows.starts], axis=1).tolist()
    return np.array([keys.index(key) * BLOCKS // len(keys) if key in keys else -1 for key in own], int)


def _near(windows: Windows, person: Windows, is_tested: np.ndarray) -> np.ndarray:
    """Return whether windows belong to the tested recordings, or overlap the tested part of the only recording."""
    if _has_many(person):
        return np.isin(windows.recordings, person.recordings[is_tested])
    is_same = windows.clips[:, None] == person.clips[is_tested][None]
    return (is_same & (np.abs(windows.starts[:, None] - person.starts[is_tested][None]) < WINDOW)).any(axis=1)


def _has_many(person: Windows) -> bool:
    return len(np.unique(person.recordings)) > 1


def discriminant(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the weights (d,) of linear discriminant analysis between samples (n, d) and (m, d).

    The covariance within the two sides, of features scaled to unit variance, is shrunk toward the identity by the rule
    of Ledoit and Wolf (2004). A feature that does not vary is given a small variance.
    """
    means = [side.mean(axis=0) for side in (first, second)]
    centred = np.concatenate([side - mean for side, mean in zip((first, second), means, strict=True)])
    scale = np.maximum(centred.std(axis=0), 1e-6)
    scaled = centred / scale
    count, size = scaled.shape
    covariance = scaled.T @ scaled / count
    distance = np.sum(np.square(covariance - np.eye(size)))
    noise = (np.mean(np.square(np.sum(np.square(scaled), axis=1))) - np.sum(np.square(covariance))) / count
    shrinkage = 1.0 if distance <= noise else noise / distance
    shrunk = (1 - shrinkage) * covariance + shrinkage * np.eye(size)
    return np.linalg.lstsq(shrunk, (means[1] - means[0]) / scale, rcond=None)[0] / scale


def area_under_curve(first: np.ndarray, second: np.ndarray) -> float:
    """Return the probability that a score of the second (m,) is above one of the first (n,); a tie counts half."""
    differences = second[:, None] - first[None]
    return float(np.mean(differences > 0) + np.mean(differences == 0) / 2)


def _row_windows(row: Row) -> Windows:
    return windows_of(row.once(row_bodies), row.numbers, row.members)


def is_tested_by_time(truth: Row) -> bool:
    """Return whether all windows of ground truth are of one recording, so that blocks of its time are held out."""
    return len(np.unique(truth.once(_row_windows).recordings)) == 1


def _told_from_truth(group: str) -> Callable[[Row], Score]:
    def measure(row: Row) -> Score:
        truth, num_recordings = row.reference.truth, row.reference.num_recordings
        if row.directions is truth.directions:  # the person, or the person with other speech
            return None
        windows = truth.once(_row_windows), row.once(_row_windows)
        if not _has_many(windows[0]):  # then the areas are those of blocks of time
            return told_apart(*windows, group)
        areas = held_out_areas(*windows, group)
        if areas is None:
            return None
        return mean_by_recording(areas.values, areas.recordings.astype(int), num_recordings, areas.windows)

    return measure


GIVEAWAY_METRICS = tuple(
    Metric(f"told_by_{group.replace(' ', '_')}", group, "", "lower", GIVEAWAY, 2, _told_from_truth(group))
    for group in (*GROUPS, ALL)
)
