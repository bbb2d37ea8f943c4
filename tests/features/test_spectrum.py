"""Spectra, filters and frequencies are those of librosa, to the last bit where features of trained models need it."""

import librosa
import numpy as np
import pytest

from ha2g_jax.features.spectrum import mel_filters, mel_frequencies, mel_spectrum, power_spectrum


@pytest.mark.parametrize(("fft_size", "hop_length"), [(1024, 512), (400, 160)])
@pytest.mark.parametrize("samples", [1024, 1025, 400_000])
def test_the_spectrum_is_librosas(fft_size, hop_length, samples):
    sound = np.random.default_rng(0).normal(0, 0.1, samples).astype(np.float32)
    expected = librosa.stft(sound, n_fft=fft_size, hop_length=hop_length, center=False)
    found = power_spectrum(sound, fft_size, hop_length)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, np.square(np.abs(expected)))


@pytest.mark.parametrize(("fft_size", "num_mels"), [(1024, 128), (400, 80), (400, 128)])
def test_the_filters_are_librosas(fft_size, num_mels):
    found = mel_filters(16000, fft_size, num_mels)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, librosa.filters.mel(sr=16000, n_fft=fft_size, n_mels=num_mels))
    expected = librosa.mel_frequencies(num_mels, fmin=0, fmax=8000)
    np.testing.assert_allclose(mel_frequencies(num_mels, 8000), expected, rtol=1e-14)


@pytest.mark.parametrize(("fft_size", "num_mels"), [(1024, 128), (400, 80), (400, 128)])
def test_every_band_and_column_has_all_of_its_frequencies(fft_size, num_mels):
    power = np.random.default_rng(0).exponential(size=(1 + fft_size // 2, 600)).astype(np.float32)
    expected = mel_filters(16000, fft_size, num_mels).astype(np.float64) @ power
    np.testing.assert_allclose(mel_spectrum(power, 16000, fft_size, num_mels), expected, rtol=1e-5)
