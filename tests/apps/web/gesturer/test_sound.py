"""A page hears what the models of Python hear: the same spectrogram of the same file."""

import pathlib

import numpy as np
import pytest
import soundfile
import soxr

from ha2g_jax.features.audio import read_audio
from ha2g_jax.features.spectrum import log_mel

SPEECH = pathlib.Path(__file__).parents[4] / "examples" / "hello.wav"
# dB. At other rates the filters that resample differ; a band at the floor may differ by more than one that is heard.
TOLERANCES = {16000: 1e-3, 48000: 5e-3, 44100: 0.1, 22050: 0.1}


@pytest.fixture(scope="module")
def spectrograms(demo_folder, do_jobs, tmp_path_factory):
    """For each rate, the path of a file and the spectrogram (128, columns) of a page."""
    folder = tmp_path_factory.mktemp("sounds")
    samples, rate = soundfile.read(SPEECH, dtype="float32")
    paths = {}
    for new_rate in TOLERANCES:
        paths[new_rate] = folder / f"{new_rate}.wav"
        mono = soxr.resample(samples, rate, new_rate) if new_rate != rate else samples
        stereo = np.stack([mono, 0.5 * mono], axis=1)
        soundfile.write(paths[new_rate], stereo, new_rate, subtype="PCM_24" if new_rate == 44100 else "PCM_16")
    jobs = [{"kind": "mel", "sound": path, "out": path.with_suffix(".f32")} for path in paths.values()]
    do_jobs(demo_folder, jobs)
    return {
        rate: (path, np.fromfile(path.with_suffix(".f32"), np.float32).reshape(-1, 128).T)
        for rate, path in paths.items()
    }


@pytest.mark.parametrize("rate", TOLERANCES)
def test_spectrogram(spectrograms, rate):
    path, found = spectrograms[rate]
    expected = log_mel(read_audio(path))
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() < TOLERANCES[rate]
