"""The sound reader takes what people have and refuses the rest in one line."""

import logging
import pathlib
import re

import av
import numpy as np
import pytest
import soundfile
import soxr
from av.stream import Disposition

from ha2g_jax.errors import UserError
from ha2g_jax.features import audio, media, spectrum


def tone(seconds: float, rate: int = 16000, hertz: float = 440) -> np.ndarray:
    return (0.3 * np.sin(2 * np.pi * hertz * np.arange(round(seconds * rate)) / rate)).astype(np.float32)


def noise(num_samples: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.1, num_samples).astype(np.float32)


@pytest.mark.parametrize("suffix", [".wav", ".flac", ".ogg", ".mp3"])
@pytest.mark.parametrize(("rate", "channels"), [(8000, 1), (44100, 2), (48000, 6)])
def test_reads_files_of_any_rate_and_channels(tmp_path, suffix, rate, channels):
    channels = min(channels, 2) if suffix == ".mp3" else channels
    path = tmp_path / f"speech{suffix}"
    soundfile.write(path, np.repeat(tone(1.5, rate)[:, None], channels, 1), rate)
    assert media.has_sound(path)
    samples = audio.read_audio(path)
    assert samples.dtype == np.float32
    assert len(samples) == 24000 or suffix == ".mp3"  # a lossy codec may add a frame
    assert np.argmax(np.abs(np.fft.rfft(samples))) * 16000 / len(samples) == pytest.approx(440, abs=1)


def test_reads_what_only_ffmpeg_reads(tmp_path):
    path = tmp_path / "speech.m4a"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=48000, layout="stereo")
        frame = av.AudioFrame.from_ndarray(np.repeat(tone(1.5, 48000)[None], 2, 0), format="fltp", layout="stereo")
        frame.sample_rate = 48000
        container.mux([*stream.encode(frame), *stream.encode(None)])
    assert media.has_sound(path)
    samples = audio.read_audio(path)
    assert len(samples) / 16000 == pytest.approx(1.5, abs=0.05)
    assert np.abs(samples).max() == pytest.approx(0.3, abs=0.05)
    np.testing.assert_allclose(np.mean(audio.read_voices(path), axis=0), samples, atol=1e-6)


@pytest.mark.parametrize("form", [np.asarray, np.transpose])
@pytest.mark.parametrize("dtype", ["float32", "float64", "int16", "int32"])
@pytest.mark.parametrize(("rate", "channels"), [(44_100, 2), (16_000, 1)])
def test_sound_of_another_library_is_that_of_its_file(tmp_path, form, dtype, rate, channels):
    path = tmp_path / "speech.wav"
    soundfile.write(path, 3 * noise(channels * rate).reshape(-1, channels).squeeze(), rate, subtype="PCM_16")
    sound, rate = soundfile.read(path, dtype=dtype)
    np.testing.assert_array_equal(audio.convert_samples(form(sound), rate), audio.read_audio(path))


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ((16_000, noise(16_000)), "pair of int and ndarray; expected .samples, rate."),
        ((noise(16_000), "16 kHz"), "expected .samples, rate."),
        ((noise(16_000), 0), "0 samples per second"),
        ((noise(16_000) > 0, 16_000), "array of bool"),
        (((32767 * noise(16_000)).astype(np.int64), 16_000), "array of int64; expected floats within -1 and 1, int16"),
        ((noise(16_000).reshape(2, 80, 100), 16_000), "expected .samples, rate."),
        ((noise(16_000).reshape(100, 160), 16_000), "shape .100, 160."),
        ((noise(160), 16_000), "0.010 s"),
        ((np.full(16_000, np.nan), 16_000), "only NaN"),
    ],
)
def test_no_sound_with_its_rate_is_refused_in_one_line(pair, message):
    with pytest.raises(UserError, match=message) as caught:
        audio.convert_samples(*pair)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rate", [8_000, 11_025, 44_100, 48_000, 96_000])
def test_sound_resampled_in_blocks_is_that_resampled_at_once(tmp_path, monkeypatch, rate):
    monkeypatch.setattr("ha2g_jax.features.media._BLOCK", 999)
    samples = noise(rate + 7)
    soundfile.write(tmp_path / "speech.wav", samples, rate, subtype="FLOAT")
    expected, found = soxr.resample(samples, rate, 16_000, "HQ"), audio.read_audio(tmp_path / "speech.wav")
    assert len(found) == round(len(samples) * 16_000 / rate)
    np.testing.assert_array_equal(found[: len(expected)], expected[: len(found)])


def test_loud_floats_are_scaled_to_full_scale(tmp_path):
    soundfile.write(tmp_path / "loud.wav", 100 * tone(1), 16000, subtype="FLOAT")
    assert np.abs(audio.read_audio(tmp_path / "loud.wav")).max() == pytest.approx(1)
    for factor in (32767, 1e20):
        loud = (factor * tone(1)).astype(np.float32)
        np.testing.assert_allclose(audio.check_samples(loud), audio.convert_samples(loud, 16000), rtol=1e-6)


def test_single_broken_samples_become_silence_with_a_warning(tmp_path, caplog):
    samples = tone(1)
    samples[[5, 7]] = np.nan, np.inf
    soundfile.write(tmp_path / "gap.wav", samples, 16000, subtype="FLOAT")
    with caplog.at_level(logging.WARNING):
        read = audio.read_audio(tmp_path / "gap.wav")
    assert np.isfinite(read).all()
    assert read[5] == read[7] == 0
    assert "2 of 16000 samples" in caplog.text


def mute_video(path: pathlib.Path) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width = stream.height = 64
        stream.pix_fmt = "yuv420p"
        image = av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8), format="rgb24")
        container.mux([*stream.encode(image), *stream.encode(None)])


BAD_FILES = {
    "empty.wav": (lambda path: path.touch(), "empty file"),
    "text.wav": (lambda path: path.write_text("these are words\n" * 40), "no sound"),
    "short.wav": (lambda path: soundfile.write(path, tone(0.19), 16000), "0.190 s"),
    "nan.wav": (lambda path: soundfile.write(path, np.full(8000, np.nan), 16000, subtype="FLOAT"), "only NaN"),
    "long.flac": (lambda path: soundfile.write(path, np.zeros(3901 * 1000, np.int16), 1000), "65 min"),
    "mute.mp4": (mute_video, "no sound"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_refused_in_one_line(tmp_path, name):
    make, message = BAD_FILES[name]
    make(tmp_path / name)
    with pytest.raises(UserError, match=re.escape(message)) as error:
        audio.read_audio(tmp_path / name)
    assert "\n" not in str(error.value)


def test_what_has_no_sound_is_told_from_what_has(tmp_path):
    (tmp_path / "text.wav").write_text("these are words\n" * 40)
    (tmp_path / "empty.wav").touch()
    mute_video(tmp_path / "silent.mp4")
    assert not any(media.has_sound(tmp_path / name) for name in ("text.wav", "empty.wav", "silent.mp4"))


def test_reads_real_recordings(private_data):
    recording = audio.read_audio(private_data / "zeroeggs_067" / "067_Speech_2_x_1_0.wav")
    assert len(recording) / 16000 == pytest.approx(68.83, abs=0.01)
    film = audio.read_audio(private_data / "video" / "sample.mp4")
    assert len(film) / 16000 == pytest.approx(17.27, abs=0.05)
    for samples in (recording, film):
        assert np.abs(samples).max() > 0.05
        assert np.mean(spectrum.log_mel(samples) > -60) > 0.2


def write_tracks(path, tracks, *, lost=(), default=0):
    """Write tracks of pieces of a tenth of a second at 16 kHz, without the pieces `lost`."""
    with av.open(str(path), "w") as container:
        streams = [container.add_stream("pcm_s16le", rate=16000, layout="mono") for _ in tracks]
        for number, stream in enumerate(streams):
            stream.disposition = Disposition.default if number == default else Disposition(0)
        for piece in sorted({*range(len(tracks[0]) // 1600)} - {*lost}):
            for stream, samples in zip(streams, tracks, strict=True):
                values = np.round(samples[None, 1600 * piece : 1600 * (piece + 1)] * 32767).astype(np.int16)
                frame = av.AudioFrame.from_ndarray(values, format="s16", layout="mono")
                frame.sample_rate, frame.pts = 16000, 1600 * piece
                container.mux(stream.encode(frame))


def test_lost_packets_are_silence_so_that_nothing_after_them_is_early(tmp_path):
    samples = tone(4)
    write_tracks(tmp_path / "a.mkv", [samples], lost=range(10, 25))
    samples[16000:40000] = 0
    np.testing.assert_allclose(audio.read_audio(tmp_path / "a.mkv"), samples, atol=1e-4)


def test_a_time_far_away_is_no_silence_that_fills_memory(tmp_path):
    write_tracks(tmp_path / "a.mkv", [tone(600)], lost=range(1, 5990))
    with pytest.raises(UserError, match="more than 1 min of sound"):
        audio.read_audio(tmp_path / "a.mkv", max_seconds=60)


def test_the_track_is_the_one_that_players_take(tmp_path):
    write_tracks(tmp_path / "a.mkv", [np.zeros(16000, np.float32), tone(1)], default=1)
    np.testing.assert_allclose(audio.read_audio(tmp_path / "a.mkv"), tone(1), atol=1e-4)


@pytest.mark.parametrize(
    ("suffix", "endian", "sizes", "size"),
    [
        ("wav", "LITTLE", [(4, 8), (40, 44)], b"\0"),
        ("wav", "LITTLE", [(4, 8), (40, 44)], b"\xff"),
        ("rf64", "LITTLE", [(20, 36)], b"\0"),
        ("w64", "LITTLE", [(16, 24), (96, 104)], b"\0"),
        ("au", "BIG", [(8, 12)], b"\xff"),
        ("au", "LITTLE", [(8, 12)], b"\xff"),
    ],
)
def test_a_header_that_was_never_finished_is_read_to_the_end_of_the_file(tmp_path, suffix, endian, sizes, size):
    path = tmp_path / f"a.{suffix}"
    soundfile.write(path, tone(1), 16000, "PCM_16", endian, suffix.upper())
    content = bytearray(path.read_bytes())
    for start, end in sizes:
        content[start:end] = size * (end - start)
    path.write_bytes(content)
    np.testing.assert_allclose(audio.read_audio(path), tone(1), atol=1e-4)


@pytest.mark.parametrize("leak", [0, 0.05])
def test_of_channels_that_cancel_each_other_the_loudest_is_taken(tmp_path, caplog, leak):
    soundfile.write(tmp_path / "a.wav", np.stack([0.9 * tone(1), -tone(1) + leak * noise(16000)], 1), 16000, "FLOAT")
    np.testing.assert_allclose(audio.read_audio(tmp_path / "a.wav"), -tone(1) + leak * noise(16000), atol=1e-6)
    assert "its channels cancel each other; channel 2 is used" in caplog.text


def test_channels_of_which_one_is_silent_are_averaged(tmp_path, caplog):
    soundfile.write(tmp_path / "a.wav", np.stack([tone(1), *np.zeros((5, 16000))], 1), 16000, "FLOAT")
    np.testing.assert_allclose(audio.read_audio(tmp_path / "a.wav"), tone(1) / 6, atol=1e-6)
    assert not caplog.text


@pytest.mark.parametrize("constant", [0.0, 0.05])
def test_silence_is_named(tmp_path, caplog, constant):
    soundfile.write(tmp_path / "a.wav", np.full(16000, constant), 16000)
    audio.read_audio(tmp_path / "a.wav")
    assert "is silent" in caplog.text
