"""One clip of speech and motion, and its bytes: the record that every source of data becomes."""

import dataclasses
import io
from typing import Any, NamedTuple, cast

import msgpack
import numpy as np
import soundfile
from PIL import Image

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word

WINDOW_FRAMES = 34  # N of the paper, at 15 fps
WINDOW_STRIDE = 10

_JPEG_QUALITY = 90
_FLOATS = ("<f4", "<f8")


class Stroke(NamedTuple):
    """A gesture whose cause is known; times in seconds.

    Attributes:
        time: when the stroke hits.
        start, end: of its preparation and of its retraction.
        kind: "beat", "semantic", "posture" or "nod".
        hand: "left", "right", "both", or "" where no hand moves.
        amplitude: size relative to an average stroke.
        word_class: class of the word that caused it, "" if none did.
    """

    time: float
    start: float
    end: float
    kind: str
    hand: str
    amplitude: float
    word_class: str


@dataclasses.dataclass(frozen=True)
class Clip:
    """Speech with its words and the motion that goes with it.

    Attributes:
        id: unique within the corpus.
        speaker: name of the speaker.
        audio: (samples,) float32 in [-1, 1], mono, 16 kHz.
        words: in order of time.
        positions: (T, joints, 3) in metres, y down; float32, or float64 where rounding would show in short bones.
        reference_frames: (M, 224, 224, 3) uint8 images of the speaker, None where the source has none.
        source_time: start in the talk, in seconds.
        window_starts: frames at which a training window may start.
        strokes: the true gestures, for a corpus that knows them.
        style: the speaker's true style vector, for a corpus that knows it.
        talk: name of the recording that the clip was cut from; splits never divide one.
        confidence: (T, joints) float32 in [0, 1], how surely each joint was seen; None where nothing was estimated.
    """

    id: str
    speaker: str
    audio: np.ndarray
    words: tuple[Word, ...]
    positions: np.ndarray
    reference_frames: np.ndarray | None
    source_time: float
    window_starts: tuple[int, ...]
    strokes: tuple[Stroke, ...] = ()
    style: tuple[float, ...] = ()
    talk: str = ""
    confidence: np.ndarray | None = None


def encode_clip(clip: Clip) -> bytes:
    """The clip as msgpack: audio in FLAC (16 bit), frames in JPEG, motion as it is. Equal clips, equal bytes."""
    flac = io.BytesIO()
    soundfile.write(flac, clip.audio, SAMPLE_RATE, format="FLAC", subtype="PCM_16")
    fields = {field.name: getattr(clip, field.name) for field in dataclasses.fields(Clip)}
    fields["audio"] = flac.getvalue()
    fields["positions"] = _pack(clip.positions)
    if clip.confidence is not None:
        fields["confidence"] = _pack(clip.confidence)
    if clip.reference_frames is not None:
        fields["reference_frames"] = [_to_jpeg(frame) for frame in clip.reference_frames]
    return cast(bytes, msgpack.packb(fields))


def decode_clip(record: bytes, name: str = "a record of the corpus") -> Clip:
    """The clip that `encode_clip` wrote.

    Args:
        record: the bytes.
        name: what to call the record in a message.

    Raises:
        UserError: the bytes are not a whole record.
    """
    fields = unpack(record, name)
    audio, frames = decode_audio(fields, name), decode_frames(fields, name)
    return Clip(**{**fields, "audio": audio, "reference_frames": frames})


def unpack(record: bytes, name: str = "a record of the corpus") -> dict[str, Any]:
    """The fields of a clip with audio and frames still compressed; quick where only motion or words are wanted.

    Raises:
        UserError: the bytes are not a whole record.
    """
    try:
        fields = _YOUNGER | msgpack.unpackb(record)
        fields["positions"] = _unpack(fields["positions"])
        if fields["confidence"] is not None:
            fields["confidence"] = _unpack(fields["confidence"])
        fields["words"] = tuple(Word(*word) for word in fields["words"])
        fields["strokes"] = tuple(Stroke(*stroke) for stroke in fields["strokes"])
        fields["window_starts"] = tuple(fields["window_starts"])
        fields["style"] = tuple(fields["style"])
    except (ValueError, TypeError, KeyError, AttributeError, msgpack.UnpackException) as error:
        raise _corrupt(name, error) from error
    names = {field.name for field in dataclasses.fields(Clip)}
    if set(fields) != names:
        raise _corrupt(name, f"fields {sorted(set(fields) ^ names)} are missing or unknown")
    return fields


# What a record of an older version lacks (see `data.schema`).
_YOUNGER = {"confidence": None}


def _pack(array: np.ndarray) -> dict[str, Any]:
    floats = "<f8" if array.dtype == np.float64 else "<f4"
    packed = {"shape": list(array.shape), "data": np.ascontiguousarray(array, floats).tobytes()}
    return packed if floats == "<f4" else {"dtype": floats, **packed}


def _unpack(packed: dict[str, Any]) -> np.ndarray:
    floats = packed.get("dtype", "<f4")
    if floats not in _FLOATS:
        raise ValueError(f"numbers of type {floats!r}")
    return np.frombuffer(packed["data"], floats).reshape(packed["shape"]).copy()


def decode_audio(fields: dict[str, Any], name: str) -> np.ndarray:
    """The samples of a clip that `unpack` gave, (samples,) float32.

    Raises:
        UserError: they are not mono FLAC at 16 kHz.
    """
    try:
        audio, rate = soundfile.read(io.BytesIO(fields["audio"]), dtype="float32")
    except (soundfile.SoundFileError, ValueError, TypeError) as error:
        raise _corrupt(f"clip {fields['id']}, {name},", error) from error
    if rate != SAMPLE_RATE or audio.ndim != 1:
        raise _corrupt(f"clip {fields['id']}, {name},", f"audio at {rate} Hz of shape {audio.shape}")
    return audio


def decode_frames(fields: dict[str, Any], name: str, count: int | None = None) -> np.ndarray | None:
    """The first `count` images of a clip that `unpack` gave, (count, height, width, 3) uint8; None where it has none.

    Raises:
        UserError: they are not images of one size.
    """
    if fields["reference_frames"] is None:
        return None
    try:
        images = [Image.open(io.BytesIO(frame)).convert("RGB") for frame in fields["reference_frames"][:count]]
        return np.stack([np.asarray(image) for image in images])
    except (OSError, ValueError, TypeError, SyntaxError, Image.DecompressionBombError) as error:
        raise _corrupt(f"clip {fields['id']}, {name},", error) from error


def _to_jpeg(frame: np.ndarray) -> bytes:
    jpeg = io.BytesIO()
    Image.fromarray(frame).save(jpeg, "JPEG", quality=_JPEG_QUALITY)
    return jpeg.getvalue()


def _corrupt(name: str, reason: object) -> UserError:
    return UserError(f"{name} is damaged ({reason}); make or import the corpus again")
