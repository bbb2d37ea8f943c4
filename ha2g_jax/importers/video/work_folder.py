"""Storage of the clips of each video until the corpus is written, so that an interrupted build can be continued."""

import hashlib
import json
import pathlib

import msgpack

from ha2g_jax.data import records
from ha2g_jax.data.recording import SplitReport
from ha2g_jax.files.reading import check_regular, reading, shown
from ha2g_jax.files.writing import whole_file
from ha2g_jax.importers.video import extraction
from ha2g_jax.importers.video.extraction import Extraction
from ha2g_jax.importers.video.recordings import VideoRecording
from ha2g_jax.importers.video.settings import VideoSettings

_SUFFIX = ".clips"
_EXPECTED = "a file of clips, which can be removed to make it again"
_MAX_COUNT = 1 << 62


def key_of(recording: VideoRecording, settings: VideoSettings) -> str:
    """Return the key of the clips of a video: a hash of contents, names, settings and version.

    Args:
        recording: the video.
        settings: settings of the import.

    Raises:
        UserError: the video or its transcript cannot be read.
    """
    transcript = recording.transcript
    facts = {
        "version": extraction.VERSION,
        "talk": recording.name,
        "speaker": recording.speaker,
        "settings": settings.as_json(),
        "video": _digest(recording.video),
        "transcript": [shown(transcript.name), _digest(transcript)] if transcript else None,
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def keys_in(folder: pathlib.Path) -> frozenset[str]:
    """Return the keys of the videos whose clips a folder has."""
    return frozenset(path.stem for path in folder.glob(f"[0-9a-f]*{_SUFFIX}"))


def save(folder: pathlib.Path, key: str, extracted: Extraction) -> None:
    """Save the clips of a video atomically.

    Args:
        folder: work folder.
        key: key of the video.
        extracted: clips of the video.

    Raises:
        UserError: the folder cannot be written.
    """
    content = extracted._asdict() | {"report": extracted.report.as_json()}
    with whole_file(folder / f"{key}{_SUFFIX}") as path:
        path.write_bytes(msgpack.packb(content) or b"")


def load(folder: pathlib.Path, key: str) -> Extraction:
    """Load the clips of a video that `save` has saved.

    Args:
        folder: work folder.
        key: key of the video.

    Raises:
        UserError: the file is missing or damaged.
    """
    path = folder / f"{key}{_SUFFIX}"
    check_regular(path, _EXPECTED)
    with reading(path, _EXPECTED, TypeError, KeyError, AttributeError, msgpack.UnpackException):
        content = msgpack.unpackb(path.read_bytes())
        extracted = Extraction(**{**content, "report": SplitReport.from_json(content["report"])})
        _check(extracted)
        return extracted


def _check(extracted: Extraction) -> None:
    report = extracted.report
    counts = [extracted.frames, extracted.frames_with_both_hands, extracted.shots]
    counts += [report.videos, report.clips, report.windows, report.kept]
    counts += [*report.filtered.values(), *report.rejected.values()]
    if not all(type(count) is int and 0 <= count < _MAX_COUNT for count in counts):
        raise ValueError("a count that is not a whole number from 0 on")
    if not all(isinstance(reason, str) for reason in [*report.filtered, *report.rejected]):
        raise ValueError("a reason that is not a text")
    if not isinstance(extracted.seconds, float) or not 0 <= extracted.seconds < _MAX_COUNT:
        raise ValueError("a length that is not a number of seconds")
    if not isinstance(extracted.records, list) or not all(isinstance(record, bytes) for record in extracted.records):
        raise ValueError("clips that are not bytes")
    for record in extracted.records:
        records.decode_clip(record)


def _digest(path: pathlib.Path) -> str:
    with reading(path, "a video with its transcript"), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
