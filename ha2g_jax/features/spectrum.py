"""Power spectra and mel filters, those of librosa, whose import takes seconds because it compiles with numba."""

import functools

import numpy as np

_LINEAR_HZ, _LINEAR_MEL = 1000.0, 15.0  # end of the linear part of Slaney's scale
_LOG_STEP = np.log(6.4) / 27  # of the logarithm of the frequency in a mel above it
_BLOCK_BYTES = 1 << 22  # of samples that are transformed together
_NEIGHBOURS = 8  # bands that are filtered together: few enough to have few frequencies, many enough to be fast
_COLUMNS = 256  # columns that are filtered together: few enough for a single thread of BLAS


def power_spectrum(padded: np.ndarray, fft_size: int, hop_length: int) -> np.ndarray:
    """Compute |STFT|^2 with a periodic Hann window, `abs(librosa.stft(padded, center=False)) ** 2`.

    Args:
        padded: (samples,) float32 sound, at least `fft_size` samples; the first column begins with the first sample.
        fft_size: samples of a column.
        hop_length: samples from one column to the next.

    Returns:
        (1 + fft_size // 2, 1 + (samples - fft_size) // hop_length) float32, in column-major order.
    """
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(fft_size) / fft_size)
    columns = np.lib.stride_tricks.sliding_window_view(padded, fft_size)[::hop_length]
    power = np.empty((len(columns), 1 + fft_size // 2), np.float32)
    size = _BLOCK_BYTES // (8 * fft_size)
    for start in range(0, len(columns), size):
        spectrum = np.fft.rfft(hann * columns[start : start + size]).astype(np.complex64)
        power[start : start + size] = np.square(np.abs(spectrum))
    return power.T


def mel_spectrum(power: np.ndarray, sample_rate: int, fft_size: int, num_mels: int) -> np.ndarray:
    """Filter power spectra with the triangles of the mel scale, `mel_filters(...) @ power`.

    Neighbouring bands are a product with the frequencies of these bands alone. The products have a tenth of the
    multiplications, and are too small to be divided among the threads of BLAS, which wait for each other in a loop and
    so take cores from a training step or a generation beside them.

    Args:
        power: (1 + fft_size // 2, columns) float32, from `power_spectrum`.
        sample_rate, fft_size, num_mels: as for `mel_filters`.

    Returns:
        (num_mels, columns) float32.
    """
    filters = mel_filters(sample_rate, fft_size, num_mels)
    mels = np.empty((num_mels, power.shape[1]), np.float32)
    for start in range(0, power.shape[1], _COLUMNS):
        columns = slice(start, start + _COLUMNS)
        for bands, frequencies in _groups(sample_rate, fft_size, num_mels):
            np.matmul(filters[bands, frequencies], power[frequencies, columns], out=mels[bands, columns])
    return mels


@functools.cache
def _groups(sample_rate: int, fft_size: int, num_mels: int) -> list[tuple[slice, slice]]:
    """Return the neighbouring bands that are filtered together, and the frequencies that they cover."""
    filters = mel_filters(sample_rate, fft_size, num_mels)
    groups = []
    for first in range(0, num_mels, _NEIGHBOURS):
        bands = slice(first, first + _NEIGHBOURS)
        covered = np.flatnonzero(filters[bands].any(axis=0))
        groups.append((bands, slice(covered[0], covered[-1] + 1)))
    return groups


@functools.cache
def mel_filters(sample_rate: int, fft_size: int, num_mels: int) -> np.ndarray:
    """Return triangles on Slaney's mel scale from 0 to half the sample rate, each of area 1, `librosa.filters.mel`.

    Args:
        sample_rate: samples per second.
        fft_size: samples of a column of the spectrum.
        num_mels: number of bands.

    Returns:
        (num_mels, 1 + fft_size // 2) float32.
    """
    edges = mel_frequencies(num_mels + 2, sample_rate / 2)
    distances, widths = edges[:, None] - np.fft.rfftfreq(fft_size, 1 / sample_rate), np.diff(edges)[:, None]
    triangles = np.minimum(-distances[:-2] / widths[:-1], distances[2:] / widths[1:])
    triangles = np.maximum(triangles, 0).astype(np.float32)
    return (triangles * (2 / (edges[2:] - edges[:-2]))[:, None]).astype(np.float32)


def mel_frequencies(count: int, highest: float) -> np.ndarray:
    """Return frequencies in Hz, (count,), evenly spaced on Slaney's mel scale, `librosa.mel_frequencies`.

    Args:
        count: number of frequencies.
        highest: the last one in Hz, at least 1000; the first is 0.
    """
    mels = np.linspace(0, _LINEAR_MEL + np.log(highest / _LINEAR_HZ) / _LOG_STEP, count)
    return np.where(
        mels < _LINEAR_MEL,
        mels * (_LINEAR_HZ / _LINEAR_MEL),
        _LINEAR_HZ * np.exp(_LOG_STEP * (mels - _LINEAR_MEL)),
    )
