"""Storage of the clips of each video until the corpus is written, so that an interrupted build can be continued."""

import hashlib
import json
import pathlib

import msgpack

from ha2g_jax.data import transcripts
from ha2g_jax.data.import_report import SplitReport
from ha2g_jax.data.video import extraction
from ha2g_jax.data.video.extraction import Extraction
from ha2g_jax.data.video.recordings import VideoRecording
from ha2g_jax.data.video.settings import VideoSettings
from ha2g_jax.errors import UserError
from ha2g_jax.files.whole_file import whole_file

_SUFFIX = ".clips"


def key_of(recording: VideoRecording, settings: VideoSettings) -> str:
    """Return the key of the clips of a video: a hash of contents, names, settings and version.

    Args:
        recording: the video.
        settings: settings of the import.

    Raises:
        UserError: the video or its transcript cannot be read.
    """
    transcript = transcripts.find(recording.video)
    facts = {
        "version": extraction.VERSION,
        "talk": recording.name,
        "speaker": recording.speaker,
        "settings": settings.as_json(),
        "video": _digest(recording.video),
        "transcript": [transcript.name, _digest(transcript)] if transcript else None,
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
    try:
        content = msgpack.unpackb(path.read_bytes())
        return Extraction(**{**content, "report": SplitReport.from_json(content["report"])})
    except (OSError, ValueError, TypeError, KeyError, AttributeError, msgpack.UnpackException) as error:
        raise UserError(f"{path} cannot be read ({error}); remove it and run again") from error


def _digest(path: pathlib.Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise UserError(f"{path} cannot be read ({(error.strerror or str(error)).lower()})") from error
