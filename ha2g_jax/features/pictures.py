"""Reader of images from untrusted files."""

import io
import pathlib
import struct
import warnings
import zlib

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_there, quiet, reason, shown
from ha2g_jax.limits import MAX_PICTURE_BYTES, MAX_PICTURE_PASSES, MAX_PICTURE_PIXELS

# Exceptions that Pillow raises for damaged images.
_ERRORS = (
    *(OSError, ValueError, ArithmeticError, SyntaxError, EOFError, LookupError, TypeError, AttributeError),
    *(RuntimeError, struct.error, zlib.error, Image.DecompressionBombError, MemoryError),
)
# Pillow knows dozens of formats, some of which start other programs and some of which are slow to decode.
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "TGA", "TIFF", "WEBP")
_START_OF_SCAN = b"\xff\xda"
_TILE_SIDES = (322, 323)  # tags of TIFF
_WIDE = ("I", "F")  # modes of 32 bits, whose range is unknown


def read_picture(path: str | pathlib.Path) -> Image.Image:
    """Read a PNG, JPEG or other common image of any size within the limits, upright, as 8-bit RGB.

    Raises:
        UserError: the file is missing, not an image, damaged, or too large.
    """
    check_there(path)
    try:
        with pathlib.Path(path).open("rb") as file:
            content = file.read(MAX_PICTURE_BYTES + 1)
        if len(content) > MAX_PICTURE_BYTES:
            raise ValueError(f"more than {MAX_PICTURE_BYTES} bytes")
        with warnings.catch_warnings(), quiet():  # the decoder of TIFF prints
            warnings.simplefilter("ignore")  # of harmless damage, and of sizes, which are checked here
            return _decode(content)
    except UnidentifiedImageError as error:
        raise UserError(f"{shown(path)} is no image; expected a PNG or JPEG of a person") from error
    except _ERRORS as error:
        raise UserError(
            f"{shown(path)} cannot be read as an image ({reason(error)}); expected a PNG or JPEG of a person"
        ) from error


def _decode(content: bytes) -> Image.Image:
    with Image.open(io.BytesIO(content), formats=_FORMATS) as image:
        tile = [getattr(image, "tag_v2", {}).get(tag, 1) for tag in _TILE_SIDES]
        for width, height in (image.size, tile):
            if width * height > MAX_PICTURE_PIXELS:
                raise ValueError(f"{width} x {height}, which is more than {MAX_PICTURE_PIXELS} pixels")
        if image.format == "JPEG" and content.count(_START_OF_SCAN) * image.width * image.height > MAX_PICTURE_PASSES:
            raise ValueError(f"a progressive JPEG of {content.count(_START_OF_SCAN)} passes; save it as PNG")
        if image.mode in _WIDE:
            raise ValueError("32 bits per channel; save it with 8 bits")
        image.load()
        upright = ImageOps.exif_transpose(image)
    if upright.mode.startswith("I;16"):
        upright = Image.fromarray((np.asarray(upright) >> 8).astype(np.uint8))
    return upright.convert("RGB")
