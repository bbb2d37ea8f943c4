"""What each video has given, kept on disk until the corpus is written, so that a build can go on after a stop."""

import hashlib
import json
import pathlib

import msgpack

from ha2g_jax.data import transcripts
from ha2g_jax.data.import_report import SplitReport
from ha2g_jax.data.video import extraction
from ha2g_jax.data.video.extraction import Extraction
from ha2g_jax.data.video.settings import VideoSettings
from ha2g_jax.data.video.talks import Talk
from ha2g_jax.errors import UserError
from ha2g_jax.files.whole_file import whole_file

_SUFFIX = ".clips"


def key_of(talk: Talk, settings: VideoSettings) -> str:
    """Names what a video gives: a hash of all that it depends on, which are contents, names, settings and version.

    Raises:
        UserError: the video or its transcript cannot be read.
    """
    transcript = transcripts.find(talk.video)
    facts = {
        "version": extraction.VERSION,
        "talk": talk.name,
        "speaker": talk.speaker,
        "settings": settings.as_json(),
        "video": _digest(talk.video),
        "transcript": [transcript.name, _digest(transcript)] if transcript else None,
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def keys_in(folder: pathlib.Path) -> frozenset[str]:
    """What a folder holds already."""
    return frozenset(path.stem for path in folder.glob(f"[0-9a-f]*{_SUFFIX}"))


def save(folder: pathlib.Path, key: str, extracted: Extraction) -> None:
    """Keeps what a video has given; the file is whole or not there.

    Raises:
        UserError: the folder cannot be written.
    """
    content = extracted._asdict() | {"report": extracted.report.as_json()}
    with whole_file(folder / f"{key}{_SUFFIX}") as path:
        path.write_bytes(msgpack.packb(content) or b"")


def load(folder: pathlib.Path, key: str) -> Extraction:
    """What `save` has kept.

    Raises:
        UserError: it is missing or damaged.
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
