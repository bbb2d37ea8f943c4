"""One clip of speech and motion, and its bytes: the record that data of every origin becomes."""

import dataclasses
import io
import struct
import types
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import msgpack
import numpy as np
import soundfile
from PIL import Image

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.files.reading import reason
from ha2g_jax.limits import MAX_NAME_LENGTH

_QUALITY = 90

_FLOATS = ("<f4", "<f8")

WINDOW_FRAMES = 34  # N of the paper, at 15 fps
WINDOW_STRIDE = 10  # frames at 15 fps between the starts of two windows
PAPER_FPS = 15

_MORE_AUDIO = 60.0  # seconds by which the audio may be longer than the motion
# Exceptions by which msgpack, numpy, libsndfile and Pillow answer damaged bytes.
DAMAGE = (
    ValueError, TypeError, KeyError, AttributeError, IndexError, ArithmeticError, EOFError, OSError, SyntaxError,
    MemoryError, struct.error, zlib.error, msgpack.UnpackException, soundfile.SoundFileError,
    Image.DecompressionBombError,
)  # fmt: skip

# Fields of `Clip` that have another name in a record.
STORED_NAMES: Mapping[str, str] = types.MappingProxyType(
    {"recording": "talk", "recording_start": "source_time", "reference_images": "reference_frames"}
)

_FIELD_NAMES = {stored: name for name, stored in STORED_NAMES.items()}


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


def encode_clip(clip: Clip) -> bytes:
    """Encode a clip as msgpack, audio in FLAC (16 bit) and images in JPEG; equal clips give equal bytes."""
    names = [field.name for field in dataclasses.fields(Clip)]
    fields = {STORED_NAMES.get(name, name): getattr(clip, name) for name in names}
    fields["audio"] = encode_flac(clip.audio)
    fields["positions"] = pack_array(clip.positions)
    if clip.confidence is not None:
        fields["confidence"] = pack_array(clip.confidence)
    if clip.reference_images is not None:
        fields["reference_frames"] = [encode_picture(image) for image in clip.reference_images]
    return cast(bytes, msgpack.packb(fields))


def decode_clip(record: bytes, name: str = "a record of the corpus") -> Clip:
    """Decode a clip that `encode_clip` has encoded; errors name the record by `name`.

    Raises:
        UserError: the bytes are not a whole record.
    """
    return decode_fields(unpack(record, name), name)


def decode_fields(fields: dict[str, Any], name: str, fps: float = 1.0) -> Clip:
    """Decode the audio and the images of a clip that `unpack` has unpacked; see `decode_audio` and `decode_images`."""
    audio, images = decode_audio(fields, name, fps), decode_images(fields, name)
    return Clip(**{**fields, "audio": audio, "reference_images": images})


def unpack(record: bytes, name: str = "a record of the corpus") -> dict[str, Any]:
    """Unpack the fields of a clip by name; audio and images stay compressed, as FLAC and as a list of JPEG images or
    None.

    Raises:
        UserError: the bytes are not a whole record.
    """
    try:
        stored: dict[str, Any] = msgpack.unpackb(record)
        fields = {_FIELD_NAMES.get(name, name): value for name, value in stored.items()}
        fields["positions"] = unpack_array(fields["positions"])
        if fields["confidence"] is not None:
            fields["confidence"] = unpack_array(fields["confidence"])
        fields["words"] = tuple(Word(*word) for word in fields["words"])
        fields["strokes"] = tuple(Stroke(*stroke) for stroke in fields["strokes"])
        fields["window_starts"] = tuple(fields["window_starts"])
        fields["style"] = tuple(fields["style"])
    except DAMAGE as error:
        raise _corrupt(name, reason(error)) from error
    if odd := set(fields) ^ {field.name for field in dataclasses.fields(Clip)}:
        raise _corrupt(name, f"fields {_printable(sorted(map(str, odd)))} are missing or unknown")
    return fields


def decode_audio(fields: dict[str, Any], name: str, fps: float = 1.0) -> np.ndarray:
    """Decode the audio of a clip that `unpack` has unpacked to (samples,) float32 at 16 kHz.

    Raises:
        UserError: the audio is not mono FLAC at 16 kHz, or much longer than the motion of `fps` frames per second.
    """
    try:
        return decode_flac(fields["audio"], len(fields["positions"]) / fps + _MORE_AUDIO)
    except DAMAGE as error:
        raise _corrupt(f"clip {_printable(fields['id'])}, {name},", reason(error)) from error


def decode_images(fields: dict[str, Any], name: str, count: int | None = None) -> np.ndarray | None:
    """Decode the first `count` images of a clip, all by default, to (count, height, width, 3) uint8; None if it has
    none.

    Raises:
        UserError: the fields are not images of one size.
    """
    if not fields["reference_images"]:
        return None
    try:
        return decode_pictures(fields["reference_images"][:count])
    except DAMAGE as error:
        raise _corrupt(f"clip {_printable(fields['id'])}, {name},", f"an image: {reason(error)}") from error


def encode_flac(audio: np.ndarray) -> bytes:
    """Encode sound (samples,) float32 in [-1, 1] at 16 kHz as FLAC of 16 bits."""
    flac = io.BytesIO()
    soundfile.write(flac, audio, SAMPLE_RATE, format="FLAC", subtype="PCM_16")
    return flac.getvalue()


def flac_seconds(flac: bytes) -> float:
    """Return the seconds that the header of FLAC states.

    Raises:
        ValueError, soundfile.SoundFileError: the bytes are not mono FLAC at 16 kHz.
    """
    with soundfile.SoundFile(io.BytesIO(flac)) as file:
        return _frames(file) / SAMPLE_RATE


def decode_flac(flac: bytes, max_seconds: float) -> np.ndarray:
    """Decode FLAC of at most `max_seconds` to (samples,) float32 at 16 kHz.

    Raises:
        ValueError, soundfile.SoundFileError: the bytes are not mono FLAC at 16 kHz, or longer.
    """
    with soundfile.SoundFile(io.BytesIO(flac)) as file:
        num_frames = _frames(file)
        if num_frames > max_seconds * SAMPLE_RATE:
            raise ValueError(
                f"{num_frames / SAMPLE_RATE:.0f} s of audio, expected {max_seconds:.0f} s at most for its motion"
            )
        return file.read(dtype="float32")


def _frames(file: soundfile.SoundFile) -> int:
    if (file.format, file.samplerate, file.channels) != ("FLAC", SAMPLE_RATE, 1):
        raise ValueError(
            f"audio in {file.format} at {file.samplerate} Hz with {file.channels} channels, expected FLAC at "
            f"{SAMPLE_RATE} Hz with 1"
        )
    return file.frames


def encode_picture(image: np.ndarray) -> bytes:
    """Encode an image (height, width, 3) uint8 as JPEG."""
    jpeg = io.BytesIO()
    Image.fromarray(image).save(jpeg, "JPEG", quality=_QUALITY)
    return jpeg.getvalue()


def decode_pictures(images: Sequence[bytes]) -> np.ndarray:
    """Decode images of one size, in JPEG or PNG, to (images, height, width, 3) uint8.

    Raises:
        ValueError, OSError, SyntaxError: they are not such images, or of several sizes.
        Image.DecompressionBombError: an image is too large.
    """
    opened = [Image.open(io.BytesIO(image), formats=("JPEG", "PNG")) for image in images]
    return np.stack([np.asarray(image.convert("RGB")) for image in opened])


def pack_array(array: np.ndarray) -> dict[str, Any]:
    """Return an array as a dict for msgpack: float64 as such, everything else as float32."""
    floats = "<f8" if array.dtype == np.float64 else "<f4"
    packed = {"shape": list(array.shape), "data": np.ascontiguousarray(array, floats).tobytes()}
    return packed if floats == "<f4" else {"dtype": floats, **packed}


def unpack_array(packed: Any) -> np.ndarray:
    """Return the array of a dict that `pack_array` has made, float32 or float64.

    Raises:
        AttributeError, KeyError, TypeError, ValueError: it is no such dict, or its shape does not fit its bytes.
    """
    floats = packed.get("dtype", "<f4")
    if floats not in _FLOATS:
        raise ValueError(f"numbers of type {repr(floats)[:20]}")
    return np.frombuffer(packed["data"], floats).reshape(packed["shape"]).copy()


def _printable(value: object) -> str:
    text = repr(value)[:MAX_NAME_LENGTH]
    return text.strip("'") if isinstance(value, str) else text


def _corrupt(name: str, why: str) -> UserError:
    return UserError(f"{name} is damaged ({why}); make or import the corpus again")
