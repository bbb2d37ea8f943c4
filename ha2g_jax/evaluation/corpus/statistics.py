"""Statistics of a corpus: sizes of each split, the report of its import, and the motion of the training split."""

import collections
import os
from typing import Any

import numpy as np
from tqdm import tqdm

from ha2g_jax.data import recording
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.recording import SplitReport, seen
from ha2g_jax.evaluation.corpus.motion import TrainingMotion
from ha2g_jax.skeleton import hand_joints

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

    Args:
        path: folder of the corpus.

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
    lengths, paces = (np.zeros(len(edges) - 1, np.int64) for edges in (SECONDS_EDGES, PACE_EDGES))
    num_clips = sum(entry["clips"] for entry in corpus.metadata["splits"].values())
    with tqdm(desc="Reading", total=num_clips, unit="clip", leave=False, disable=None) as progress:
        for split in corpus.splits:
            clips = corpus.clips(split)
            for index in range(len(clips)):
                fields = clips.fields(index)
                counts[split].add(fields)
                total.add(fields)
                if split == TRAIN:
                    motion.update(fields["positions"], fields["window_starts"])
                seconds = len(fields["positions"]) / corpus.fps
                _count(lengths, SECONDS_EDGES, seconds)
                if seconds >= _SHORTEST_PACE and fields["words"]:
                    _count(paces, PACE_EDGES, 60 * len(fields["words"]) / seconds)
                progress.update()
    return {
        "name": str(corpus.metadata.get("name", corpus.path.resolve().name)),
        "source": str(corpus.metadata.get("source", "")),
        "licence": str(corpus.metadata.get("licence", "")),
        "skeleton": corpus.skeleton.name,
        "fps": corpus.fps,
        "splits": {split: group.as_json() for split, group in counts.items()},
        "total": total.as_json(),
        "training": motion.result(),
        "import": corpus.metadata.get("import", {}),
        "failed": corpus.metadata.get("failed", []),
        "clip_seconds": lengths.tolist(),
        "clip_pace": paces.tolist(),
    }


def as_table(summary: dict[str, Any]) -> str:
    """Format the statistics of a corpus as text.

    Args:
        summary: statistics that `summarise` returns.
    """
    blocks = [
        [
            f"{summary['name']}: {summary['skeleton']}, {summary['fps']:g} frames per second",
            *(f"{key}: {summary[key]}" for key in ("source", "licence") if summary[key]),
        ],
        _aligned(split_rows(summary)),
        *_motion_blocks(summary["training"] or {}),
    ]
    if summary["import"]:
        blocks.append(["import", recording.report_as_table(report_of(summary))])
    return "\n\n".join("\n".join(block) for block in blocks)


def split_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Make a table with one column per split, without empty rows.

    Args:
        summary: statistics that `summarise` returns.

    Returns:
        The title and the cells of each row.
    """
    splits = {**summary["splits"], "total": summary["total"]}
    rows = [["", *splits]]
    for key, (title, form) in _ROWS.items():
        values = [split[key] for split in splits.values()]
        if any(value is not None for value in values):
            rows.append([title, *("-" if value is None else format(value, form) for value in values)])
    return rows


def report_of(summary: dict[str, Any]) -> recording.Report:
    """Return the report of the import of a corpus.

    Args:
        summary: statistics that `summarise` returns.
    """
    return {split: SplitReport.from_json(counts) for split, counts in summary["import"].items()}


def joint_rows(training: dict[str, Any]) -> list[list[str]]:
    """Make a table of the inner angles of shoulders and elbows beside the published ones, in degrees.

    Args:
        training: statistics that `TrainingMotion.result` returns.
    """
    rows = [["inner angle, degrees", "mean", "std", "published", "std", "Table 10", '"var"']]
    for joint, angle in training["joints"].items():
        found = [angle.get(key) for key in ("corpus", "published", "table_10")]
        cells = ["-" if one is None else f"{one[key]:.1f}" for one in found for key in ("mean", "std")]
        rows.append([joint.replace("_", " "), *cells])
    return rows


def bone_rows(training: dict[str, Any]) -> list[list[str]]:
    """Make a table of the lengths of the bones in centimetres.

    Args:
        training: statistics that `TrainingMotion.result` returns.
    """
    rows = [["bone, centimetres", "mean", "std", "published"]]
    for bone, length in training["bones"].items():
        rows.append([bone, *(f"{100 * length[key]:.1f}" for key in ("mean", "std", "published"))])
    return rows


def angle_rows(training: dict[str, Any]) -> list[list[str]]:
    """Make a table of the angles of the physical loss in degrees, and of their changes from frame to frame.

    Args:
        training: statistics that `TrainingMotion.result` returns.
    """
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


def _count(histogram: np.ndarray, edges: np.ndarray, value: float) -> None:
    histogram[min(int(np.searchsorted(edges, value, "right")) - 1, len(histogram) - 1)] += 1


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
