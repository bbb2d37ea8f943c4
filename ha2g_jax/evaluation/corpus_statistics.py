"""Compute the statistics of a corpus: sizes of each split, the report of its import, the motion of training."""

import collections
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.recording import report_as_table, report_from_json, seen
from ha2g_jax.data.records import WINDOW_FRAMES, frames_at
from ha2g_jax.files.reading import resolved
from ha2g_jax.progress import progress_bar
from ha2g_jax.skeleton import Skeleton, bone_lengths, hand_joints, joint_angles, load_skeleton, positions_to_directions

# Inner angles of TED-Expressive in degrees, with the values that the paper calls variances (HA2G, Table 10). They are
# neither the variances of the published data (49, 355, 44, 343) nor their roots, and are used as standard deviations.
TABLE_10 = {
    "left_shoulder": (116.6, 9.01),
    "right_shoulder": (127.1, 7.53),
    "left_elbow": (75.1, 7.30),
    "right_elbow": (85.3, 7.22),
}
ANGLE_EDGES = np.linspace(0, 180, 91)
SPEED_EDGES = np.linspace(0, 4, 161)  # m/s; the last bin includes higher speeds
SECONDS_EDGES = np.arange(0, 62, 2)  # seconds of a clip; the last bin includes longer clips
PACE_EDGES = np.arange(0, 410, 10)  # words per minute of a clip; the last bin includes faster clips

_SEEN = 0.5  # minimum confidence of a joint that counts as seen, if the corpus does not store its settings
_SHORTEST_PACE = 3.0  # seconds; in shorter clips, words per minute are not meaningful
_ROWS = {  # title and format of each number of a split in the table
    "clips": ("clips", ",d"),
    "recordings": ("recordings", ",d"),
    "speakers": ("speakers", ",d"),
    "hours": ("hours", ",.3f"),
    "windows": ("windows", ",d"),
    "words": ("words", ",d"),
    "words_per_minute": ("words per minute", ".0f"),
    "vocabulary": ("different words", ",d"),
    "unknown_words": ("words unknown to training", ".1%"),
    "reference_images": ("images of speakers", ",d"),
    "confidence": ("mean confidence", ".2f"),
    "both_hands": ("frames with both hands", ".1%"),
}
_TITLE_WIDTH, _MIN_WIDTH = 34, 10


def summarise(path: str | os.PathLike) -> dict[str, Any]:
    """Compute the statistics of a corpus, without decoding audio and images.

    Returns:
        A dict ready for JSON. "splits" and "total": clips, recordings, speakers, hours, windows, words,
        words_per_minute, vocabulary (number of different words), unknown_words (fraction of words that training does
        not have), reference_images (number of images), confidence (mean), both_hands (fraction of the frames in which
        every joint of both hands is seen); None for values that the corpus does not have. "training":
        `TrainingMotion.result`. "import": the report of the import. "failed": videos that failed. "clip_seconds" and
        "clip_pace": counts of clips over `SECONDS_EDGES` and `PACE_EDGES`.

    Raises:
        UserError: there is no corpus, or a record cannot be used.
    """
    corpus = Corpus.open(path)
    motion, total = TrainingMotion(corpus.skeleton, corpus.fps), _Counts(corpus)
    counts = {split: _Counts(corpus) for split in corpus.splits}
    lengths, paces = [], []
    with progress_bar("reading the corpus", corpus.num_clips, "clip") as bar:
        for split in corpus.splits:
            clips = corpus.clips(split)
            for index in range(len(clips)):
                fields = clips.fields(index)
                counts[split].add(fields)
                total.add(fields)
                if split == TRAIN:
                    motion.update(fields["positions"], fields["window_starts"])
                seconds = len(fields["positions"]) / corpus.fps
                lengths.append(seconds)
                if seconds >= _SHORTEST_PACE and fields["words"]:
                    paces.append(60 * len(fields["words"]) / seconds)
                bar.update()
    return {
        "name": str(corpus.metadata.get("name", resolved(corpus.path).name)),
        "source": str(corpus.metadata.get("source", "")),
        "licence": str(corpus.metadata.get("licence", "")),
        "skeleton": corpus.skeleton.name,
        "fps": corpus.fps,
        "splits": {split: group.as_json() for split, group in counts.items()},
        "total": total.as_json(),
        "training": motion.result(),
        "import": corpus.metadata.get("import", {}),
        "failed": corpus.metadata.get("failed", []),
        "clip_seconds": np.histogram(np.minimum(lengths, SECONDS_EDGES[-1]), SECONDS_EDGES)[0].tolist(),
        "clip_pace": np.histogram(np.minimum(paces, PACE_EDGES[-1]), PACE_EDGES)[0].tolist(),
    }


def as_table(summary: dict[str, Any]) -> str:
    """Format what `summarise` returns as text."""
    blocks = [
        [
            f"{summary['name']}: {summary['skeleton']}, {summary['fps']:g} frames per second",
            *(f"{key}: {summary[key]}" for key in ("source", "licence") if summary[key]),
        ],
        _aligned(split_rows(summary)),
        *_motion_blocks(summary["training"] or {}),
    ]
    if summary["import"]:
        blocks.append(["import", report_as_table(report_from_json(summary["import"]))])
    return "\n\n".join("\n".join(block) for block in blocks)


def split_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Make a table of what `summarise` returns, one column per split, without empty rows."""
    splits = {**summary["splits"], "total": summary["total"]}
    rows = [["", *splits]]
    for key, (title, form) in _ROWS.items():
        values = [split[key] for split in splits.values()]
        if any(value is not None for value in values):
            rows.append([title, *("-" if value is None else format(value, form) for value in values)])
    return rows


def joint_rows(training: dict[str, Any]) -> list[list[str]]:
    """Make a table of the inner angles of shoulders and elbows and the published ones, in degrees."""
    rows = [["inner angle, degrees", "mean", "std", "published", "std", "Table 10", '"var"']]
    for joint, angle in training["joints"].items():
        found = [angle.get(key) for key in ("corpus", "published", "table_10")]
        cells = ["-" if one is None else f"{one[key]:.1f}" for one in found for key in ("mean", "std")]
        rows.append([joint.replace("_", " "), *cells])
    return rows


def bone_rows(training: dict[str, Any]) -> list[list[str]]:
    """Make a table of the lengths of the bones in centimetres."""
    rows = [["bone, centimetres", "mean", "std", "published"]]
    for bone, length in training["bones"].items():
        rows.append([bone, *(f"{100 * length[key]:.1f}" for key in ("mean", "std", "published"))])
    return rows


def angle_rows(training: dict[str, Any]) -> list[list[str]]:
    """Make a table of the angles of the physical loss in degrees, and of their changes from frame to frame."""
    rows = [["angle of two bones, degrees", "mean", "std", "change", "published", "std", "change"]]
    return rows + [[name, *(f"{value:.1f}" for value in angle.values())] for name, angle in training["angles"].items()]


def _motion_blocks(training: dict[str, Any]) -> list[list[str]]:
    if not training:
        return []
    speed = training["wrist_speed"]
    return [
        ["Frames of training that lie in a window:"],
        *(_aligned(rows(training)) for rows in (joint_rows, bone_rows, angle_rows)),
        [
            f"wrists move at {speed['mean']:.2f} m/s on average, {speed['median']:.2f} in the median, "
            f"{speed['percentile_95']:.2f} at 95 %"
        ],
    ]


def _aligned(rows: list[list[str]]) -> list[str]:
    """Align a table: the first column to the left, the others to the right."""
    widths = [max(_MIN_WIDTH, *map(len, column)) for column in zip(*(row[1:] for row in rows), strict=True)]
    first = max(_TITLE_WIDTH, *(len(row[0]) for row in rows))
    return [
        " ".join([f"{row[0]:<{first}}", *(f"{cell:>{width}}" for cell, width in zip(row[1:], widths, strict=True))])
        for row in rows
    ]


class _Counts:
    """Sums over the clips of a split."""

    def __init__(self, corpus: Corpus):
        self._known = set(corpus.metadata["words"]) if corpus.has_clips(TRAIN) else None
        self._fps = corpus.fps
        hands = hand_joints(corpus.skeleton)
        self._hands = hands if len(hands) > 2 else []  # two wrists only are not hands
        settings = corpus.metadata.get("video", {}).get("settings", {})
        self._seen = settings.get("min_confidence", _SEEN)
        self._recordings: set[str] = set()
        self._speakers: set[str] = set()
        self._words: collections.Counter[str] = collections.Counter()
        self._clips = self._frames = self._windows = self._images = 0
        self._judged, self._confidence, self._both_hands = 0, 0.0, 0

    def add(self, fields: dict[str, Any]) -> None:
        self._clips += 1
        self._frames += len(fields["positions"])
        self._windows += len(fields["window_starts"])
        self._images += len(fields["reference_images"] or ())
        self._recordings.add(fields["recording"] or fields["id"])
        self._speakers.add(fields["speaker"])
        self._words.update(word.text.lower() for word in fields["words"])
        confidence = fields["confidence"]
        if confidence is not None:
            self._judged += len(confidence)
            self._confidence += float(confidence.mean(axis=1).sum())
            self._both_hands += int(seen(confidence[:, self._hands], self._seen).sum())

    def as_json(self) -> dict[str, Any]:
        minutes, words = self._frames / self._fps / 60, self._words.total()
        known = self._known if words else None
        unknown = None if known is None else sum(n for word, n in self._words.items() if word not in known) / words
        return {
            "clips": self._clips,
            "recordings": len(self._recordings),
            "speakers": len(self._speakers),
            "hours": minutes / 60,
            "windows": self._windows,
            "words": words,
            "words_per_minute": words / minutes if minutes else None,
            "vocabulary": len(self._words),
            "unknown_words": unknown,
            "reference_images": self._images,
            "confidence": self._confidence / self._judged if self._judged else None,
            "both_hands": self._both_hands / self._judged if self._judged and self._hands else None,
        }


class TrainingMotion:
    """Sums over the frames of a training split that lie in a window."""

    def __init__(self, skeleton: Skeleton, fps: float):
        self._skeleton, self._fps = skeleton, fps
        self._wrists = [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]
        self._joints = inner_angles(skeleton)
        self._histograms = {joint: np.zeros(len(ANGLE_EDGES) - 1, np.int64) for joint in self._joints}
        self._speeds = np.zeros(len(SPEED_EDGES) - 1, np.int64)
        self._speed = 0.0
        self._lengths = np.zeros((2, skeleton.num_bones))  # sums of the lengths and of their squares
        self._frames = 0

    def update(self, positions: np.ndarray, window_starts: Sequence[int]) -> None:
        """Add a clip of positions (T, joints, 3) in metres with the first frame of each window."""
        is_seen = np.zeros(len(positions), bool)
        for start in window_starts:
            is_seen[start : start + frames_at(WINDOW_FRAMES, self._fps)] = True
        positions = positions.astype(np.float64)
        directions = positions_to_directions(self._skeleton, positions[is_seen])
        angles = 180 - np.rad2deg(joint_angles(self._skeleton, directions))
        for joint, pair in self._joints.items():
            self._histograms[joint] += np.histogram(angles[:, pair], ANGLE_EDGES)[0]
        is_step = is_seen[1:] & is_seen[:-1]
        speeds = np.linalg.norm(np.diff(positions[:, self._wrists], axis=0), axis=-1)[is_step] * self._fps
        self._speeds += np.histogram(np.minimum(speeds, SPEED_EDGES[-1]), SPEED_EDGES)[0]
        self._speed += speeds.sum()
        lengths = bone_lengths(self._skeleton, positions[is_seen])
        self._lengths += lengths.sum(axis=0), (lengths**2).sum(axis=0)
        self._frames += len(lengths)

    def result(self) -> dict[str, Any] | None:
        """Return the statistics ready for JSON in metres, metres per second and degrees; None if there is no window."""
        if not self._frames:
            return None
        mean, square = self._lengths / self._frames
        deviation = np.sqrt(np.maximum(square - mean**2, 0))
        published = load_skeleton(self._skeleton.name)
        bones = [f"{published.joints[parent]} - {published.joints[child]}" for parent, child in published.bones]
        steps = max(int(self._speeds.sum()), 1)
        return {
            "frames": self._frames,
            "bones": {
                name: {"mean": float(mean[bone]), "std": float(deviation[bone]), "published": float(length)}
                for bone, (name, length) in enumerate(zip(bones, published.lengths, strict=True))
            },
            "joints": {joint: self._joint(joint, published) for joint in self._joints},
            "angles": _angles(self._skeleton, published),
            "wrist_speed": {
                "mean": float(self._speed / steps),
                "median": _quantile(self._speeds, SPEED_EDGES, 0.5),
                "percentile_95": _quantile(self._speeds, SPEED_EDGES, 0.95),
                "histogram": self._speeds.tolist(),
            },
        }

    def _joint(self, joint: str, published: Skeleton) -> dict[str, Any]:
        pair = self._joints[joint]
        found = {
            name: {
                "mean": 180 * (1 - float(skeleton.angle_mean[pair])),
                "std": 180 * float(np.sqrt(skeleton.angle_variance[pair])),
            }
            for name, skeleton in {"corpus": self._skeleton, "published": published}.items()
        }
        if published.name == "ted_expressive":
            found["table_10"] = dict(zip(("mean", "std"), TABLE_10[joint], strict=True))
        return {**found, "histogram": self._histograms[joint].tolist()}


def inner_angles(skeleton: Skeleton) -> dict[str, int]:
    """Return the index of the angle pair at each shoulder and elbow; the inner angle is 180 degrees minus its angle."""
    joints = {}
    for joint in TABLE_10:
        end = skeleton.joint(joint)
        for number, (first, second) in enumerate(skeleton.angle_pairs):
            bones = skeleton.bones
            if max(first, second) < len(bones) and bones[first][1] == end == bones[second][0]:
                joints[joint] = number
    return joints


def pair_names(skeleton: Skeleton) -> list[str]:
    """Return the name of each pair of direction vectors, after the joints at the ends of its bones."""
    names = [*(skeleton.joints[child] for _, child in skeleton.bones), "left palm", "right palm"]
    return [f"{names[first]} - {names[second]}" for first, second in skeleton.angle_pairs]


def _angles(skeleton: Skeleton, published: Skeleton) -> dict[str, dict[str, float]]:
    """Return the angle of every pair of direction vectors in degrees (HA2G, Eq. 8), of the corpus and as published."""
    return {
        name: {
            f"{prefix}{kind}": 180 * float(value)
            for prefix, of in {"": skeleton, "published_": published}.items()
            for kind, value in (
                ("mean", of.angle_mean[number]),
                ("std", np.sqrt(of.angle_variance[number])),
                ("change", of.angle_change[number]),
            )
        }
        for number, name in enumerate(pair_names(skeleton))
    }


def _quantile(counts: np.ndarray, edges: np.ndarray, fraction: float) -> float:
    """Return the value below which a fraction of a histogram lies, linearly interpolated within its bin."""
    total = np.concatenate([[0], np.cumsum(counts)])
    return float(np.interp(fraction * total[-1], total, edges))
