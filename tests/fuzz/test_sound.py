"""Any file of sound is read or refused in one line, in little time and memory."""

import contextlib
import os
import pathlib
import struct

import numpy as np
import pytest
import soundfile
from fuzz import recordings
from fuzz.mutation import FUZZ, damaged_bytes
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import read_audio

SOUND_FILES = {
    **{f"{kind[1]}.{kind[0].lower()}": kind for kind in recordings.SOUNDFILE_KINDS},
    **{f"{kind[1]}.{kind[0]}": kind for kind in recordings.FFMPEG_SOUND_KINDS + recordings.VIDEO_KINDS},
}
# Values at which headers go wrong.
_ODD = st.sampled_from((0, 1, 3, 7, 255, 1024, 65_535, 2**31 - 1, 2**31, 2**32 - 1)) | st.integers(0, 2**32 - 1)


def content_of(name: str) -> bytes:
    kind = SOUND_FILES[name]
    return recordings.soundfile_bytes(*kind) if len(kind) == 2 else recordings.ffmpeg_bytes(*kind)


def wav(
    data: bytes, *, channels: int = 1, rate: int = 16_000, bits: int = 16, kind: int = 1, size: int | None = None
) -> bytes:
    """Return a WAV whose header says anything."""
    block = channels * bits // 8
    form = struct.pack(
        "<HHIIHH", kind, channels % 2**16, rate % 2**32, rate * block % 2**32, block % 2**16, bits % 2**16
    )
    head = b"WAVEfmt " + struct.pack("<I", len(form)) + form + b"data"
    size = len(data) if size is None else size
    return b"RIFF" + struct.pack("<I", (len(head) + len(data) + 4) % 2**32) + head + struct.pack("<I", size) + data


@pytest.mark.parametrize("name", SOUND_FILES)
def test_the_files_to_damage_are_read(tmp_path, name):
    (tmp_path / name).write_bytes(content_of(name))
    assert len(read_audio(tmp_path / name)) == pytest.approx(4_000, rel=0.4)


@FUZZ
@given(data=st.data(), name=st.sampled_from(sorted(SOUND_FILES)))
def test_damaged_sound(answered, data, name):
    answered(read_audio, data.draw(damaged_bytes(content_of(name))), name)


@FUZZ
@given(data=st.data(), name=st.sampled_from(sorted(SOUND_FILES)))
def test_a_damaged_header(answered, data, name):
    content = content_of(name)
    answered(read_audio, data.draw(damaged_bytes(content[:200])) + content[200:], name)


@FUZZ
@given(channels=_ODD, rate=_ODD, bits=_ODD, kind=st.sampled_from((1, 2, 3, 6, 7, 0x11, 0x55, 0xFFFE)), size=_ODD)
def test_any_header_of_wav(answered, channels, rate, bits, kind, size):
    answered(read_audio, wav(bytes(20_000), channels=channels, rate=rate, bits=bits, kind=kind, size=size), "x.wav")


def rf64(num_bytes: int) -> bytes:
    """Return a RF64 of a second that declares `num_bytes`."""
    sizes = struct.pack("<IQQQI", 28, num_bytes, num_bytes, num_bytes // 2, 0)
    return b"RF64" + b"\xff" * 4 + b"WAVEds64" + sizes + wav(bytes(32_000), size=2**32 - 1)[12:]


def flac(folder: pathlib.Path, rate: int, channels: int, seconds: float, *, declared: int | None = None) -> bytes:
    """Return silence, with another number of samples in its header if `declared` is given."""
    path = folder / "silence.flac"
    block = np.zeros((1 << 20, channels), np.int16)
    with soundfile.SoundFile(path, "w", rate, channels, subtype="PCM_16") as file:
        for start in range(0, round(seconds * rate), len(block)):
            file.write(block[: round(seconds * rate) - start])
    content = bytearray(path.read_bytes())
    if declared is not None:
        content[21] = content[21] & 0xF0 | declared >> 32
        content[22:26] = struct.pack(">I", declared % 2**32)
    return bytes(content)


REFUSED = {
    "65 minutes at 655,350 Hz": (
        lambda folder: flac(folder, 655_350, 1, 1, declared=655_350 * 3_899),
        "too long for a",
    ),
    "hours in the header": (lambda folder: flac(folder, 16_000, 1, 1, declared=2**36 - 1), "more than 65 minutes"),
    "65,535 channels": (lambda _: wav(bytes(80_000), channels=65_535), "channels"),
    "no channels": (lambda _: wav(bytes(16_000), channels=0), "channels"),
    "no bits per sample": (lambda _: wav(bytes(16_000), bits=0), "unknown codec"),
    "no rate": (lambda _: wav(bytes(16_000), rate=0), "no sound that can be read"),
    "a rate of 2 GHz": (lambda _: wav(bytes(16_000), rate=2**31 - 1), "declares 2147483647 samples per second"),
    "a negative ds64": (lambda _: rf64(2**64 - 1), "no sound that can be read"),
    "a list of addresses": (lambda _: b"#EXTM3U\n#EXTINF:9,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n", "no sound"),
    "a list of files": (lambda _: b"ffconcat version 1.0\nfile '/etc/passwd'\n", "no sound that can be read"),
    "values that overflow": (
        lambda _: wav(np.full(9_000, 3e38, "<f4").tobytes(), bits=32, kind=3),
        "only NaN or infinite",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_impossible_sound_is_refused_in_one_line(refused, tmp_path, name):
    make, message = REFUSED[name]
    path = tmp_path / "speech.wav"
    path.write_bytes(make(tmp_path))
    assert message in refused("generate", str(path), "-o", str(tmp_path / "out"))


def test_a_header_that_promises_more_than_there_is_does_not_matter(tmp_path):
    for content in (rf64(2**60), wav(bytes(32_000), size=2**32 - 1)):
        (tmp_path / "speech.wav").write_bytes(content)
        assert len(read_audio(tmp_path / "speech.wav")) == 16_000


def test_sound_without_a_stated_length_ends_at_the_limit(answered, tmp_path):
    """A megabyte of silence is an hour and a half of sound; it must not fill the memory."""
    content = flac(tmp_path, 1_000, 1, 5_400, declared=0)

    def read(path: pathlib.Path) -> None:
        with pytest.raises(UserError, match="more than 65 minutes"):
            read_audio(path)

    answered(read, content, "endless.flac")


def test_eight_channels_are_read_by_ffmpeg(tmp_path):
    """PyAV's own conversion of such frames to arrays ends the process."""
    (tmp_path / "film.mka").write_bytes(recordings.ffmpeg_bytes("matroska", "flac", "", "7.1"))
    assert np.abs(read_audio(tmp_path / "film.mka")).max() == pytest.approx(0.35, abs=0.05)


def test_a_damaged_mp3_prints_nothing(tmp_path, capfd):
    content = bytearray(recordings.soundfile_bytes("MP3", "MPEG_LAYER_III"))
    content[300:900] = bytes(range(200)) * 3
    (tmp_path / "speech.mp3").write_bytes(content)
    with contextlib.suppress(UserError):
        read_audio(tmp_path / "speech.mp3")
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


@pytest.mark.parametrize("name", [os.fsdecode(b"sp\xff\xe9ech.wav"), "12:30.wav", "-x\u202e\n.wav"])
def test_a_file_of_any_name_is_read_or_refused(refused, tmp_path, name):
    path = tmp_path / name
    for kind, make in {"wav": recordings.soundfile_bytes, "ipod": recordings.ffmpeg_bytes}.items():
        path.write_bytes(make("WAV", "PCM_16") if kind == "wav" else make("ipod", "aac", ""))
        assert len(read_audio(path)) >= 4_000
    path.write_bytes(b"these are words")
    line = refused("generate", str(path), "-o", str(tmp_path / "out"))
    assert line.isprintable() and "no sound that can be read" in line
