"""Sounds in which nobody speaks, for the Talk corpus: noise of many kinds, and music made of synthetic instruments.

They are computed in float64, so that the last bits, which differ between processors, vanish in 16 bits.
"""

import functools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ha2g_jax.features.audio import SAMPLE_RATE

_SCALES = ((0, 2, 4, 5, 7, 9, 11), (0, 2, 3, 5, 7, 8, 10), (0, 2, 4, 7, 9), (0, 3, 5, 7, 10))  # semitones
_CHORDS = (0, 3, 4, 5)  # degrees of the scale on which chords are built
_TRIAD = (0, 2, 4)
_BEATS = 4  # beats in a bar
_STEPS = 16  # steps of a pattern of drums in a bar
_LOWEST_HZ, _HIGHEST_HZ = 55.0, 7500.0
_PERIOD = 512  # samples of one period of an instrument
_BLOCK, _LEAST_HZ = 4096, 20.0  # of noise
_RELEASE = 0.05  # seconds in which a note ends


def draw_noise(num_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Draw noise (samples,) at 16 kHz with a mean power of 1: steady or swelling, of any colour, hum, bursts or clicks.

    A part of it is always steady noise, 10 to 50 dB below the others.
    """
    make = (_steady, _swelling, _hum, _bursts)[rng.integers(4)]
    return _normal(_normal(make(num_samples, rng)) + 10 ** (rng.uniform(-50, -10) / 20) * _steady(num_samples, rng))


def draw_music(num_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Draw music (samples,) at 16 kHz with a mean power of 1, of some of chords, arpeggio, melody, bass and drums."""
    parts = [part for part in (_chords, _arpeggio, _melody, _bass, _drums) if rng.random() < 0.5]
    beat = 60 / rng.uniform(60, 170)
    tonic, scale = _LOWEST_HZ * 2 ** (rng.integers(12) / 12), _SCALES[rng.integers(len(_SCALES))]
    bars = int(num_samples / SAMPLE_RATE / (_BEATS * beat)) + 1
    song = _Song(beat, float(tonic), scale, rng.choice(_CHORDS, bars).tolist())
    mix = np.zeros(num_samples)
    for part in parts or [_chords]:
        track = np.zeros(num_samples)
        for start, sound in part(song, rng):
            first = round(start * SAMPLE_RATE)
            track[first : first + len(sound)] += sound[: max(num_samples - first, 0)]
        mix += rng.uniform(0.3, 1) * _normal(track)
    return _normal(mix)


def coloured_noise(num_samples: int, exponent: float, rng: np.random.Generator) -> np.ndarray:
    """Draw noise (samples,) with a mean power of 1 and power density f^-exponent: 0 white, 1 pink, 2 brown."""
    size = _BLOCK * -(-num_samples // _BLOCK)  # a length with small prime factors, for a fast FFT
    spectrum = np.fft.rfft(rng.standard_normal(size))
    spectrum /= np.maximum(np.fft.rfftfreq(size, 1 / SAMPLE_RATE), _LEAST_HZ) ** (exponent / 2)
    return _normal(np.fft.irfft(spectrum, size)[:num_samples])


def _normal(sound: np.ndarray) -> np.ndarray:
    return sound / max(np.sqrt(np.mean(sound**2)), 1e-9)


def _steady(num_samples: int, rng: np.random.Generator) -> np.ndarray:
    return coloured_noise(num_samples, rng.uniform(0, 2), rng)


def _swelling(num_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Draw noise such as wind, rain or traffic, whose level changes by some decibels from moment to moment."""
    gap = np.exp(rng.uniform(np.log(0.1), np.log(3.0))) * SAMPLE_RATE
    levels = rng.normal(0, 7, int(num_samples / gap) + 2)
    gain = np.interp(np.arange(num_samples) / gap, np.arange(len(levels)), levels)
    return _steady(num_samples, rng) * 10 ** (gain / 20)


def _hum(num_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Draw the hum of the mains or of a machine."""
    frequency = rng.choice([50.0, 60.0, rng.uniform(30, 200)])
    count = int(rng.integers(3, 30))
    weights = rng.exponential(size=count) / np.arange(1, count + 1) ** rng.uniform(0, 1.5)
    return _play(_Instrument(weights, 0.1, 1e3, 0.0), frequency, num_samples / SAMPLE_RATE)[:num_samples]


def _bursts(num_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Draw bursts of noise at irregular times, from clicks of milliseconds to thuds."""
    rate, decay = (np.exp(rng.uniform(*np.log(ends))) for ends in ((0.5, 8.0), (0.002, 0.3)))
    envelope = np.zeros(num_samples + round(6 * decay * SAMPLE_RATE))
    shape = np.exp(-np.arange(round(6 * decay * SAMPLE_RATE)) / (decay * SAMPLE_RATE))
    for start in rng.integers(num_samples, size=1 + rng.poisson(rate * num_samples / SAMPLE_RATE)):
        envelope[start : start + len(shape)] += rng.uniform(0.2, 1) * shape
    return envelope[:num_samples] * _steady(num_samples, rng)


class _Song(NamedTuple):
    """Seconds of a beat, the lowest tone in hertz, the scale in semitones, and the degree of the chord of each bar."""

    beat: float
    tonic: float
    scale: tuple[int, ...]
    chords: list[int]

    def pitch(self, degree: int) -> float:
        octave, step = divmod(degree, len(self.scale))
        return self.tonic * 2 ** (octave + self.scale[step] / 12)

    def triads(self) -> Iterator[tuple[float, list[int]]]:
        """Yield the start in seconds and the degrees of the chord of each bar."""
        for bar, chord in enumerate(self.chords):
            yield bar * _BEATS * self.beat, [chord + step for step in _TRIAD]


class _Instrument(NamedTuple):
    """Weights of the harmonics, seconds of attack and decay, and the depth of the vibrato as a ratio of frequencies."""

    harmonics: np.ndarray
    attack: float
    decay: float
    vibrato: float


def _instrument(
    rng: np.random.Generator, attack: tuple[float, float], decay: tuple[float, float], vibrato: float = 0.0
) -> _Instrument:
    harmonics = rng.uniform(0.2, 1, 12) / np.arange(1, 13) ** rng.uniform(0.5, 2.5)
    return _Instrument(harmonics, rng.uniform(*attack), rng.uniform(*decay), rng.uniform(0, vibrato))


@functools.cache
def _sines(count: int) -> np.ndarray:
    return np.sin(2 * np.pi * np.arange(1, count + 1)[:, None] * np.arange(_PERIOD + 1) / _PERIOD)


def _play(instrument: _Instrument, frequency: float, seconds: float) -> np.ndarray:
    times = np.arange(round((seconds + _RELEASE) * SAMPLE_RATE)) / SAMPLE_RATE
    count = max(1, min(len(instrument.harmonics), int(_HIGHEST_HZ / frequency)))
    period = (instrument.harmonics[:count, None] * _sines(count)).sum(axis=0)
    waver = instrument.vibrato / (2 * np.pi * 5.5) * np.sin(2 * np.pi * 5.5 * times) if instrument.vibrato else 0.0
    phase = frequency * (times + waver) % 1 * _PERIOD
    place = phase.astype(int)
    wave = period[place] + (phase - place) * (period[np.minimum(place + 1, _PERIOD)] - period[place])
    envelope = (1 - np.exp(-times / instrument.attack)) * np.exp(-times / instrument.decay)
    return wave * envelope * np.minimum(1, (times[-1] - times) / _RELEASE)


_Notes = Iterator[tuple[float, np.ndarray]]  # start in seconds, and samples


def _chords(song: _Song, rng: np.random.Generator) -> _Notes:
    instrument, octave = _instrument(rng, (0.005, 0.4), (0.5, 6.0), 0.003), int(rng.integers(1, 3))
    for start, triad in song.triads():
        for degree in triad:
            yield start, _play(instrument, song.pitch(degree) * 2**octave, _BEATS * song.beat)


def _arpeggio(song: _Song, rng: np.random.Generator) -> _Notes:
    instrument, octave = _instrument(rng, (0.002, 0.01), (0.1, 0.8)), int(rng.integers(2, 4))
    length, order = song.beat / rng.choice([1, 2, 2, 4]), rng.permutation([0, 1, 2, 1])
    for start, triad in song.triads():
        for number in range(round(_BEATS * song.beat / length)):
            tone = song.pitch(triad[order[number % len(order)]]) * 2**octave
            yield start + number * length, _play(instrument, tone, 2 * length)


def _melody(song: _Song, rng: np.random.Generator) -> _Notes:
    instrument, octave = _instrument(rng, (0.01, 0.1), (0.4, 4.0), 0.025), int(rng.integers(2, 4))
    time, degree = 0.0, int(rng.integers(len(song.scale)))
    while time < len(song.chords) * _BEATS * song.beat:
        length = song.beat * rng.choice([0.5, 0.5, 1, 1, 2, 3])
        degree = int(np.clip(degree + rng.integers(-3, 4), -3, 9))
        if rng.random() < 0.85:  # otherwise a rest
            yield time, _play(instrument, song.pitch(degree) * 2**octave, length)
        time += length


def _bass(song: _Song, rng: np.random.Generator) -> _Notes:
    instrument, per_bar = _instrument(rng, (0.005, 0.02), (0.2, 1.5)), int(rng.choice([1, 2, 4, 8]))
    for start, triad in song.triads():
        for number in range(per_bar):
            length = _BEATS * song.beat / per_bar
            yield start + number * length, _play(instrument, song.pitch(triad[0]), length)


def _drums(song: _Song, rng: np.random.Generator) -> _Notes:
    times = np.arange(SAMPLE_RATE // 2) / SAMPLE_RATE
    fall = rng.uniform(0.02, 0.05)  # seconds in which the pitch of the kick falls
    phase = rng.uniform(40, 60) * times - 100 * fall * np.exp(-times / fall)
    kick = np.sin(2 * np.pi * phase) * np.exp(-times / 0.12)
    snare = rng.standard_normal(len(times)) * np.exp(-times / rng.uniform(0.04, 0.15))
    hat = np.diff(rng.standard_normal(len(times) + 1)) * np.exp(-times / rng.uniform(0.01, 0.06))
    # Probabilities of each drum on the beat, on the half and on the quarters between.
    drums = ((kick, (0.6, 0.2, 0.1)), (0.4 * snare, (0.4, 0.1, 0.1)), (0.2 * hat, (0.8, 0.7, 0.3)))
    for drum, (on, half, between) in drums:
        pattern = np.flatnonzero(rng.random(_STEPS) < np.tile([on, between, half, between], _STEPS // 4))
        for start, _ in song.triads():
            for step in pattern.tolist():
                yield start + step * song.beat * _BEATS / _STEPS, rng.uniform(0.7, 1) * drum
