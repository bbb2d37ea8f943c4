"""One clip of speech and motion, and its encoding as a record, the same for data of every origin."""

import contextlib
import dataclasses
import io
import types
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, cast

import msgpack
import numpy as np
import soundfile
from PIL import Image

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.files.reading import reason

WINDOW_FRAMES = 34  # N of the paper, at 15 fps
WINDOW_STRIDE = 10  # frames at 15 fps between the starts of two windows
PAPER_FPS = 15

_JPEG_QUALITY = 90
# Exceptions that msgpack, NumPy, libsndfile and Pillow raise for damaged bytes.
_DAMAGE = (
    *(ValueError, TypeError, LookupError, AttributeError, ArithmeticError, OSError),
    *(msgpack.UnpackException, soundfile.SoundFileError),
)

# Fields of `Clip` that have another name in a record.
STORED_NAMES: Mapping[str, str] = types.MappingProxyType(
    {"recording": "talk", "recording_start": "source_time", "reference_images": "reference_frames"}
)

_FIELD_NAMES = {stored: name for name, stored in STORED_NAMES.items()}


class Stroke(NamedTuple):
    """A gesture whose cause is known: its hit, start of the preparation and end of the retraction, in seconds.

    Attributes:
        kind: "beat", "stance", "semantic", "posture" or "nod".
        hand: "left", "right", "both", or "" if no hand moves.
        amplitude: size relative to an average stroke.
        word_class: class of the word that caused the stroke, or name of the stance, else "".
    """

    time: float
    start: float
    end: float
    kind: str
    hand: str
    amplitude: float
    word_class: str


def frames_at(frames: int, fps: float) -> int:
    """Return the number of frames at `fps` that last as long as `frames` at 15 fps, rounded, at least 1."""
    return max(1, round(frames * fps / PAPER_FPS))


@dataclasses.dataclass(frozen=True)
class Clip:
    """Speech, its words, and the motion that accompanies it.

    Attributes:
        id: name of the clip, unique within the corpus.
        audio: (samples,) float32 in [-1, 1], mono, 16 kHz.
        words: words in order of time, in seconds from the start of the clip.
        positions: (T, joints, 3) in metres, y down; float32, or float64 where rounding would change short bones.
        reference_images: (M, 224, 224, 3) uint8 images of the speaker, None if there are none.
        recording_start: start of the clip in its recording, in seconds.
        window_starts: frames at which a training window may start.
        strokes, style: true gestures and true style vector of the speaker, if they are known.
        recording: name of the recording that the clip was cut from; a recording is never divided among splits.
        confidence: (T, joints) float32 in [0, 1] for the estimate of each joint; None if positions were not estimated.
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

    def __repr__(self) -> str:
        return f"Clip({self.id!r}, {self.speaker!r}, {len(self.positions)} frames, {len(self.words)} words)"


def encode_clip(clip: Clip) -> bytes:
    """Encode a clip as msgpack, audio in FLAC (16 bit) and images in JPEG; equal clips give equal bytes."""
    names = [field.name for field in dataclasses.fields(Clip)]
    fields = {STORED_NAMES.get(name, name): getattr(clip, name) for name in names}
    flac = io.BytesIO()
    soundfile.write(flac, clip.audio, SAMPLE_RATE, format="FLAC", subtype="PCM_16")
    fields["audio"] = flac.getvalue()
    fields["positions"] = _pack_array(clip.positions)
    if clip.confidence is not None:
        fields["confidence"] = _pack_array(clip.confidence)
    if clip.reference_images is not None:
        fields["reference_frames"] = [_encode_image(image) for image in clip.reference_images]
    return cast(bytes, msgpack.packb(fields))


def decode_clip(record: bytes, name: str = "a record") -> Clip:
    """Decode a clip that `encode_clip` has encoded; errors name the record by `name`.

    Raises:
        UserError: the bytes are damaged.
    """
    fields = unpack(record, name)
    fields |= {"audio": decode_audio(fields, name), "reference_images": decode_images(fields, name)}
    return Clip(**fields)


def unpack(record: bytes, name: str = "a record") -> dict[str, Any]:
    """Unpack the fields of a clip by name; audio and images stay compressed: FLAC, and a list of JPEG images or None.

    Raises:
        UserError: the bytes are damaged.
    """
    with _decoding(name):
        stored: dict[str, Any] = msgpack.unpackb(record)
        fields = {_FIELD_NAMES.get(name, name): value for name, value in stored.items()}
        fields["positions"] = _unpack_array(fields["positions"])
        if fields["confidence"] is not None:
            fields["confidence"] = _unpack_array(fields["confidence"])
        fields["words"] = tuple(Word(*word) for word in fields["words"])
        fields["strokes"] = tuple(Stroke(*stroke) for stroke in fields["strokes"])
        fields["window_starts"] = tuple(fields["window_starts"])
        fields["style"] = tuple(fields["style"])
    return fields


def decode_audio(fields: dict[str, Any], name: str) -> np.ndarray:
    """Decode the audio of a clip that `unpack` has unpacked to (samples,) float32 at 16 kHz.

    Raises:
        UserError: the audio is damaged.
    """
    with _decoding(f"clip {fields['id']}, {name},"):
        return soundfile.read(io.BytesIO(fields["audio"]), dtype="float32")[0]


def decode_images(fields: dict[str, Any], name: str, count: int | None = None) -> np.ndarray | None:
    """Decode the first `count` images of a clip, all by default, to (count, height, width, 3) uint8; None without any.

    Raises:
        UserError: an image is damaged.
    """
    if not fields["reference_images"]:
        return None
    with _decoding(f"clip {fields['id']}, {name},"):
        opened = [Image.open(io.BytesIO(image), formats=("JPEG",)) for image in fields["reference_images"][:count]]
        return np.stack([np.asarray(image.convert("RGB")) for image in opened])


def _encode_image(image: np.ndarray) -> bytes:
    jpeg = io.BytesIO()
    Image.fromarray(image).save(jpeg, "JPEG", quality=_JPEG_QUALITY)
    return jpeg.getvalue()


def _pack_array(array: np.ndarray) -> dict[str, Any]:
    """Return an array as a dict for msgpack: float64 as such, everything else as float32."""
    floats = "<f8" if array.dtype == np.float64 else "<f4"
    packed = {"shape": list(array.shape), "data": np.ascontiguousarray(array, floats).tobytes()}
    return packed if floats == "<f4" else {"dtype": floats, **packed}


def _unpack_array(packed: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(packed["data"], packed.get("dtype", "<f4")).reshape(packed["shape"]).copy()


@contextlib.contextmanager
def _decoding(name: str) -> Iterator[None]:
    """Turn the exceptions of libraries on damaged bytes into a `UserError`."""
    try:
        yield
    except _DAMAGE as error:
        raise UserError(f"{name} is damaged ({reason(error)}); make or import the corpus again") from error
