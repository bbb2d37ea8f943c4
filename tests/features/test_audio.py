"""The sound reader takes what people have and refuses the rest in one line; the mel is librosa's."""

import logging
import pathlib
import re

import av
import librosa
import numpy as np
import pytest
import soundfile

from ha2g_jax.errors import UserError
from ha2g_jax.features import audio, sound_files


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
    assert sound_files.has_sound(path)
    samples = audio.read_audio(path)
    assert samples.dtype == np.float32
    assert len(samples) == 24000 or suffix == ".mp3"  # a lossy codec may add a frame
    spectrum = np.abs(np.fft.rfft(samples))
    assert np.argmax(spectrum) * 16000 / len(samples) == pytest.approx(440, abs=1)


def test_reads_what_only_ffmpeg_reads(tmp_path):
    path = tmp_path / "speech.m4a"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=48000, layout="stereo")
        frame = av.AudioFrame.from_ndarray(np.repeat(tone(1.5, 48000)[None], 2, 0), format="fltp", layout="stereo")
        frame.sample_rate = 48000
        container.mux([*stream.encode(frame), *stream.encode(None)])
    assert sound_files.has_sound(path)
    samples = audio.read_audio(path)
    assert len(samples) / 16000 == pytest.approx(1.5, abs=0.05)
    assert np.abs(samples).max() == pytest.approx(0.3, abs=0.05)


@pytest.mark.parametrize("rate", [8_000, 11_025, 44_100, 48_000, 96_000])
def test_sound_resampled_in_blocks_is_that_resampled_at_once(tmp_path, monkeypatch, rate):
    monkeypatch.setattr("ha2g_jax.features.sound_files._BLOCK", 999)
    samples = noise(rate + 7)
    soundfile.write(tmp_path / "speech.wav", samples, rate, subtype="FLOAT")
    whole = librosa.resample(samples, orig_sr=rate, target_sr=16_000, res_type="soxr_hq")
    expected = librosa.util.fix_length(whole, size=round(len(samples) * 16_000 / rate))
    np.testing.assert_array_equal(audio.read_audio(tmp_path / "speech.wav"), expected)


def test_a_loud_float_file_is_scaled_to_full_scale(tmp_path):
    soundfile.write(tmp_path / "loud.wav", 100 * tone(1), 16000, subtype="FLOAT")
    assert np.abs(audio.read_audio(tmp_path / "loud.wav")).max() == pytest.approx(1)


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
    "missing.wav": (lambda path: None, "no file"),
    "folder.wav": (lambda path: path.mkdir(), "a folder"),
    "empty.wav": (lambda path: path.touch(), "empty file"),
    "text.wav": (lambda path: path.write_text("these are words\n" * 40), "no sound"),
    "text.mp3": (lambda path: path.write_text("these are words\n" * 40), "no sound"),
    "no_samples.wav": (lambda path: soundfile.write(path, np.zeros(0), 16000), "0.000 s"),
    "short.wav": (lambda path: soundfile.write(path, tone(0.19), 16000), "0.190 s"),
    "nan.wav": (lambda path: soundfile.write(path, np.full(8000, np.nan), 16000, subtype="FLOAT"), "only NaN"),
    "slow.wav": (lambda path: soundfile.write(path, tone(1), 5), "declares 5 samples per second"),
    "long.flac": (lambda path: soundfile.write(path, np.zeros(3901 * 1000, np.int16), 1000), "65 minutes"),
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
    with av.open(str(tmp_path / "silent.mp4"), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width = stream.height = 64
        frame = av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8))
        container.mux([*stream.encode(frame), *stream.encode(None)])
    assert not any(sound_files.has_sound(tmp_path / name) for name in ("text.wav", "empty.wav", "silent.mp4"))


def test_a_damaged_file_is_refused(tmp_path):
    path = tmp_path / "speech.flac"
    soundfile.write(path, noise(32000), 16000)
    path.write_bytes(path.read_bytes()[:20000])
    with pytest.raises(UserError, match="no sound that can be read"):
        audio.read_audio(path)


def test_mel_is_librosas_with_reflected_borders():
    samples = noise(36267)
    power = librosa.feature.melspectrogram(
        y=samples, sr=16000, n_fft=1024, hop_length=512, n_mels=128, pad_mode="reflect"
    )
    expected = librosa.power_to_db(power, ref=np.max, top_db=80)
    mel = audio.log_mel(samples)
    assert mel.shape == (128, 71)
    assert mel.dtype == np.float32
    np.testing.assert_allclose(mel, expected, atol=1e-3)


def test_mel_of_a_tone_peaks_in_the_band_of_its_pitch():
    mel = audio.log_mel(tone(1, hertz=1000))
    centres = librosa.mel_frequencies(130, fmin=0, fmax=8000)[1:-1]
    assert abs(centres[np.argmax(mel[:, 15])] - 1000) < 40
    assert mel.max() == 0
    assert mel.min() == -80


@pytest.mark.parametrize("num_samples", [1, 2, 511, 512, 513, 1024])
def test_mel_of_a_very_short_clip(num_samples):
    mel = audio.log_mel(noise(num_samples))
    assert mel.shape == (128, 1 + num_samples // 512)
    assert np.isfinite(mel).all()


def test_silence_is_the_floor_and_a_quiet_clip_is_as_loud_as_a_loud_one():
    assert (audio.log_mel(np.zeros(16000, np.float32)) == -80).all()
    np.testing.assert_allclose(audio.log_mel(1e-4 * noise(16000)), audio.log_mel(noise(16000)), atol=1e-2)


def test_a_given_reference_is_the_zero_of_the_scale():
    half = audio.log_mel(noise(16000), reference=1e3)
    np.testing.assert_allclose(audio.log_mel(noise(16000), reference=1e2), np.minimum(half + 10, 0), atol=1e-3)
    assert half.max() <= 0


def test_windows_are_whole_and_silent_past_the_end():
    mel = np.arange(128 * 100, dtype=np.float32).reshape(128, 100) - 13000
    assert [audio.window_column(frame, 15) for frame in (0, 1, 15, 30, 60, 90)] == [0, 2, 31, 62, 125, 188]
    np.testing.assert_array_equal(audio.mel_window(mel, 0, 34, 15), mel[:, :70])
    window = audio.mel_window(mel, 30, 34, 15)
    assert window.shape == (128, 70)
    np.testing.assert_array_equal(window[:, :38], mel[:, 62:])
    assert (window[:, 38:] == -80).all()
    assert (audio.mel_window(mel, 900, 34, 15) == -80).all()


def test_a_window_of_a_long_clip_is_that_of_the_same_sound_alone():
    samples = noise(16000 * 12)
    start = 120 * 16000 // 15  # on a column
    window = audio.mel_window(audio.log_mel(samples, reference=1), 120, 34, 15)
    alone = audio.log_mel(samples[start : start + 36267], reference=1)
    np.testing.assert_allclose(window[:, 1:69], alone[:, 1:69], atol=1e-3)  # the outer columns reach further


def test_clicks_lie_in_their_windows():
    samples = np.zeros(16000 * 60, np.float32)
    clicks = np.arange(1, 60, 2)  # one in each stride of two seconds, a second after its start
    samples[clicks * 16000] = 1
    mel = audio.log_mel(samples)
    loudest = [np.argmax(audio.mel_window(mel, 30 * window, 34, 15).sum(axis=0)) for window in range(29)]
    assert set(loudest) <= {31, 32}  # a second is 31.25 columns


def test_reads_real_recordings(private_data):
    recording = audio.read_audio(private_data / "zeroeggs_067" / "067_Speech_2_x_1_0.wav")
    assert len(recording) / 16000 == pytest.approx(68.83, abs=0.01)
    film = audio.read_audio(private_data / "video" / "sample.mp4")
    assert len(film) / 16000 == pytest.approx(17.27, abs=0.05)
    for samples in (recording, film):
        assert np.abs(samples).max() > 0.05
        assert np.mean(audio.log_mel(samples) > -60) > 0.2
