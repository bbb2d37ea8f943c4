"""One clip of speech and motion, and its bytes: the record that data of every origin becomes."""

import dataclasses
import io
import types
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import msgpack
import numpy as np
import soundfile
from PIL import Image

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.pictures import PICTURE_ERRORS, decode_picture
from ha2g_jax.features.text import Word
from ha2g_jax.limits import MAX_CLIP_PIXELS

WINDOW_FRAMES = 34  # N of the paper, at 15 fps
WINDOW_STRIDE = 10  # frames at 15 fps between the starts of two windows
PAPER_FPS = 15

_JPEG_QUALITY = 90
_FLOATS = ("<f4", "<f8")


class Stroke(NamedTuple):
    """A gesture whose cause is known; times in seconds.

    Attributes:
        time: time at which the stroke hits.
        start: start of the preparation.
        end: end of the retraction.
        kind: "beat", "semantic", "posture" or "nod".
        hand: "left", "right", "both", or "" if no hand moves.
        amplitude: size relative to an average stroke.
        word_class: class of the word that caused the stroke, "" if none did.
    """

    time: float
    start: float
    end: float
    kind: str
    hand: str
    amplitude: float
    word_class: str


def frames_at(frames: int, fps: float) -> int:
    """Return as many frames at `fps` as take the time of `frames` at 15 fps, rounded, at least 1."""
    return max(1, round(frames * fps / PAPER_FPS))


@dataclasses.dataclass(frozen=True)
class Clip:
    """Speech with its words and the motion that goes with it.

    Attributes:
        id: name of the clip, unique within the corpus.
        speaker: name of the speaker.
        audio: (samples,) float32 in [-1, 1], mono, 16 kHz.
        words: words in order of time, in seconds from the start of the clip.
        positions: (T, joints, 3) in metres, y down; float32, or float64 where rounding would change short bones.
        reference_images: (M, 224, 224, 3) uint8 images of the speaker, None if there are none.
        recording_start: start of the clip in its recording, in seconds.
        window_starts: frames at which a training window may start.
        strokes: true gestures, in a corpus where they are known.
        style: true style vector of the speaker, in a corpus where it is known.
        recording: name of the recording that the clip was cut from; a recording is never divided among splits.
        confidence: (T, joints) float32 in [0, 1], confidence of the estimate of each joint; None if the positions were
            not estimated.
    """

    id: str
    speaker: str
    audio: np.ndarray
    words: tuple[Word, ...]
    positions: np.ndarray
    reference_images: np.ndarray | None
    recording_start: float
    window_starts: tuple[int, ...]
    strokes: tuple[Stroke, ...] = ()
    style: tuple[float, ...] = ()
    recording: str = ""
    confidence: np.ndarray | None = None


# Fields of `Clip` that have another name in a record.
STORED_NAMES: Mapping[str, str] = types.MappingProxyType(
    {"recording": "talk", "recording_start": "source_time", "reference_images": "reference_frames"}
)


def encode_clip(clip: Clip) -> bytes:
    """Encode a clip as msgpack: audio in FLAC (16 bit), images in JPEG, motion uncompressed.

    Args:
        clip: the clip.

    Returns:
        The record; equal clips give equal bytes.
    """
    flac = io.BytesIO()
    soundfile.write(flac, clip.audio, SAMPLE_RATE, format="FLAC", subtype="PCM_16")
    names = [field.name for field in dataclasses.fields(Clip)]
    fields = {STORED_NAMES.get(name, name): getattr(clip, name) for name in names}
    fields["audio"] = flac.getvalue()
    fields["positions"] = _pack(clip.positions)
    if clip.confidence is not None:
        fields["confidence"] = _pack(clip.confidence)
    if clip.reference_images is not None:
        fields["reference_frames"] = [_to_jpeg(image) for image in clip.reference_images]
    return cast(bytes, msgpack.packb(fields))


def decode_clip(record: bytes, name: str = "a record of the corpus") -> Clip:
    """Decode a clip that `encode_clip` has encoded.

    Args:
        record: bytes of the record.
        name: name of the record in an error message.

    Raises:
        UserError: the bytes are not a whole record.
    """
    fields = unpack(record, name)
    audio, images = decode_audio(fields, name), decode_images(fields, name)
    return Clip(**{**fields, "audio": audio, "reference_images": images})


def unpack(record: bytes, name: str = "a record of the corpus") -> dict[str, Any]:
    """Unpack the fields of a clip and leave audio and images compressed, which is fast if only motion or words are
    needed.

    Args:
        record: bytes of the record.
        name: name of the record in an error message.

    Returns:
        The fields of `Clip` by name; "audio" is FLAC, "reference_images" a list of JPEG images or None.

    Raises:
        UserError: the bytes are not a whole record.
    """
    try:
        stored: dict[str, Any] = _YOUNGER | msgpack.unpackb(record)
        fields = {_FIELD_NAMES.get(name, name): value for name, value in stored.items()}
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


_FIELD_NAMES = {stored: name for name, stored in STORED_NAMES.items()}
# Defaults of the fields that a record of an older version does not have (see `data.schema`).
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
    """Decode the audio of a clip that `unpack` has unpacked.

    Args:
        fields: fields of the clip.
        name: name of the record in an error message.

    Returns:
        (samples,) float32 at 16 kHz.

    Raises:
        UserError: the audio is not mono FLAC at 16 kHz.
    """
    try:
        audio, rate = soundfile.read(io.BytesIO(fields["audio"]), dtype="float32")
    except (soundfile.SoundFileError, ValueError, TypeError) as error:
        raise _corrupt(f"clip {fields['id']}, {name},", error) from error
    if rate != SAMPLE_RATE or audio.ndim != 1:
        raise _corrupt(f"clip {fields['id']}, {name},", f"audio at {rate} Hz of shape {audio.shape}")
    return audio


def decode_images(fields: dict[str, Any], name: str, count: int | None = None) -> np.ndarray | None:
    """Decode the images of a clip that `unpack` has unpacked.

    Args:
        fields: fields of the clip.
        name: name of the record in an error message.
        count: number of images to decode, from the first one; all by default.

    Returns:
        (count, height, width, 3) uint8 images, None if the clip has none.

    Raises:
        UserError: the fields are not images of one size.
    """
    if fields["reference_images"] is None:
        return None
    try:
        return np.stack(
            [np.asarray(decode_picture(frame, MAX_CLIP_PIXELS)) for frame in fields["reference_images"][:count]]
        )
    except PICTURE_ERRORS as error:
        raise _corrupt(f"clip {fields['id']}, {name},", error) from error


def _to_jpeg(frame: np.ndarray) -> bytes:
    jpeg = io.BytesIO()
    Image.fromarray(frame).save(jpeg, "JPEG", quality=_JPEG_QUALITY)
    return jpeg.getvalue()


def _corrupt(name: str, reason: object) -> UserError:
    return UserError(f"{name} is damaged ({reason}); make or import the corpus again")
