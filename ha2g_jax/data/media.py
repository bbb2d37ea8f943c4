"""Sound and images in a record, whose sizes are read from their headers before they are decoded."""

import io
from collections.abc import Sequence

import numpy as np
import soundfile
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.limits import MAX_CLIP_IMAGE_SIDE, MAX_CLIP_IMAGES, MAX_CLIP_PIXELS

_QUALITY = 90
_PNG = b"\x89PNG"


def encode_audio(audio: np.ndarray) -> bytes:
    """Encode sound as FLAC of 16 bits.

    Args:
        audio: (samples,) float32 in [-1, 1] at 16 kHz.
    """
    flac = io.BytesIO()
    soundfile.write(flac, audio, SAMPLE_RATE, format="FLAC", subtype="PCM_16")
    return flac.getvalue()


def audio_seconds(flac: bytes) -> float:
    """Return the seconds that the header of FLAC states.

    Args:
        flac: bytes of the sound.

    Raises:
        ValueError, soundfile.SoundFileError: the bytes are not mono FLAC at 16 kHz.
    """
    with soundfile.SoundFile(io.BytesIO(flac)) as file:
        return _frames(file) / SAMPLE_RATE


def decode_audio(flac: bytes, max_seconds: float) -> np.ndarray:
    """Decode sound.

    Args:
        flac: bytes of the sound.
        max_seconds: maximum length in seconds.

    Returns:
        (samples,) float32 at 16 kHz.

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


def encode_image(image: np.ndarray) -> bytes:
    """Encode an image as JPEG.

    Args:
        image: (height, width, 3) uint8.
    """
    jpeg = io.BytesIO()
    Image.fromarray(image).save(jpeg, "JPEG", quality=_QUALITY)
    return jpeg.getvalue()


def decode_images(images: Sequence[bytes]) -> np.ndarray:
    """Decode images of one size.

    Args:
        images: bytes of the images, at least one.

    Returns:
        (images, height, width, 3) uint8.

    Raises:
        ValueError, OSError, SyntaxError: they are not images in JPEG or PNG, of several sizes, too many or too large.
    """
    if not 0 < len(images) <= MAX_CLIP_IMAGES:
        raise ValueError(f"{len(images)} images, expected 1 to {MAX_CLIP_IMAGES}")
    # Not Image.open, which warns of a large image before its size can be checked.
    opened = [(PngImageFile if image.startswith(_PNG) else JpegImageFile)(io.BytesIO(image)) for image in images]
    sizes = sorted({image.size for image in opened})
    if len(sizes) > 1:
        raise ValueError(f"images of {len(sizes)} sizes, {' and '.join(f'{w} x {h}' for w, h in sizes[:2])}")
    width, height = sizes[0]
    if max(width, height) > MAX_CLIP_IMAGE_SIDE:
        raise ValueError(f"{width} x {height} pixels, expected {MAX_CLIP_IMAGE_SIDE} x {MAX_CLIP_IMAGE_SIDE} at most")
    if len(opened) * width * height > MAX_CLIP_PIXELS:
        raise ValueError(
            f"{len(opened)} images of {width} x {height} pixels, expected {MAX_CLIP_PIXELS} pixels at most"
        )
    return np.stack([np.asarray(image.convert("RGB")) for image in opened])
