"""Any picture is read or refused in one line: damaged, truncated, a decompression bomb, of other depths and colours."""

import io
import os
import struct
import zlib

import numpy as np
import pytest
from fuzz import recordings
from fuzz.mutation import FUZZ, damaged_bytes
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from ha2g_jax.errors import UserError
from ha2g_jax.features.pictures import read_picture

COLOURS = np.random.default_rng(0).integers(0, 256, (8, 8, 3)).repeat(8, 0).repeat(8, 1).astype(np.uint8)
KINDS = {
    "a.png": ("RGB", "PNG", {}),
    "palette.png": ("P", "PNG", {}),
    "clear.png": ("RGBA", "PNG", {}),
    "a.jpg": ("RGB", "JPEG", {}),
    "progressive.jpg": ("RGB", "JPEG", {"progressive": True}),
    "print.jpg": ("CMYK", "JPEG", {}),
    "a.webp": ("RGB", "WEBP", {}),
    "a.gif": ("P", "GIF", {}),
    "a.bmp": ("RGB", "BMP", {}),
    "a.tga": ("RGB", "TGA", {}),
    "lzw.tif": ("RGB", "TIFF", {"compression": "tiff_lzw"}),
    "deflate.tif": ("CMYK", "TIFF", {"compression": "tiff_deflate"}),
    "jpeg.tif": ("RGB", "TIFF", {"compression": "jpeg"}),
}


def picture(mode: str, kind: str, options: dict) -> bytes:
    file = io.BytesIO()
    Image.fromarray(COLOURS).convert(mode).save(file, kind, **options)
    return file.getvalue()


CONTENTS = {name: picture(*kind) for name, kind in KINDS.items()}


@pytest.mark.parametrize("name", CONTENTS)
def test_the_pictures_to_damage_are_read(tmp_path, name):
    (tmp_path / name).write_bytes(CONTENTS[name])
    read = read_picture(tmp_path / name)
    assert (read.mode, read.size) == ("RGB", (64, 64))


@FUZZ
@given(data=st.data(), name=st.sampled_from(sorted(CONTENTS)))
def test_a_damaged_picture(answered, capfd, data, name):
    answered(read_picture, data.draw(damaged_bytes(CONTENTS[name])), name)
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def many_passes() -> bytes:
    """Return a progressive JPEG whose last pass over its 4,096 x 4,096 pixels comes a thousand times."""
    file = io.BytesIO()
    Image.new("L", (4096, 4096)).save(file, "JPEG", progressive=True)
    content = file.getvalue()
    last = content[content.rindex(b"\xff\xda") : -2]
    return content[:-2] + 1_000 * last + content[-2:]


def tiled(side: int) -> bytes:
    """Return a TIFF of 64 x 64 whose one tile is larger than the picture."""
    tags = {256: 64, 257: 64, 258: 8, 259: 8, 262: 1, 277: 1, 322: side, 323: side, 324: 200, 325: 100}
    fields = b"".join(struct.pack("<2H2I", tag, 4, 1, value) for tag, value in tags.items())
    return (
        struct.pack("<2sHIH", b"II", 42, 8, len(tags)) + fields + bytes(4) + zlib.compress(bytes(10_000)) + bytes(200)
    )


REFUSED = {
    "30,000 x 30,000": (lambda: recordings.png(30_000, 30_000), "exceeds limit"),
    "10,000 x 10,000": (lambda: recordings.png(10_000, 10_000), "more than 67108864 pixels"),
    "2 G x 2 G": (lambda: recordings.png(2**31 - 1, 2**31 - 1), "exceeds limit"),
    "no pixels": (lambda: recordings.png(0, 0), "cannot be read as an image"),
    "cut": (lambda: CONTENTS["a.jpg"][:-200], "truncated"),
    "a thousand passes": (many_passes, "passes"),
    "tiles of 60,000 x 60,000": (
        lambda: tiled(60_000),
        "60000 x 60000, which is more than 67108864 pixels",
    ),
    "32 bits": (lambda: picture("F", "TIFF", {}), "32 bits per channel"),
    "text": (lambda: b"these are words\n" * 9, "cannot identify"),
    "a program": (lambda: b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "cannot identify"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_impossible_pictures_are_refused_in_one_line(answered, name):
    make, message = REFUSED[name]

    def read(path) -> None:
        with pytest.raises(UserError, match=message) as caught:
            read_picture(path)
        assert str(caught.value).isprintable()

    answered(read, make(), os.fsdecode(b"pict\xffure.png"))


@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
def test_16_bits_are_as_bright_as_8(tmp_path, kind):
    Image.fromarray(COLOURS[..., 0].astype(np.uint16) * 257).save(tmp_path / "deep", kind)
    np.testing.assert_array_equal(np.asarray(read_picture(tmp_path / "deep")), COLOURS[..., :1].repeat(3, 2))
