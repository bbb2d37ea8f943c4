"""Other examples out of one: seen in a mirror, spoken more quietly, heard through noise.

Pure functions of one example (see `Windows`). All randomness comes from the generator that is passed in.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.features.audio import FLOOR_DB, NUM_MELS, SAMPLE_RATE, WINDOW_COLUMNS, log_mel
from ha2g_jax.features.librosa_once import librosa
from ha2g_jax.skeleton import Skeleton, mirror_directions

_NOISE_SECONDS = 16


class Augmentation(NamedTuple):
    """What is changed at random in a training window; nothing by default.

    Attributes:
        jitter: most frames by which it starts late.
        mirror: share of windows seen in a mirror.
        gain_db: most dB by which the speech is made quieter.
        noise: share of windows with noise in the speech.
        noise_snr_db: least and most dB by which the speech is louder than the noise.
    """

    jitter: int = 0
    mirror: float = 0.0
    gain_db: float = 0.0
    noise: float = 0.0
    noise_snr_db: tuple[float, float] = (10.0, 40.0)


def augment(
    example: dict[str, Any],
    augmentation: Augmentation,
    skeleton: Skeleton,
    num_speakers: int,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """The example after everything but the jitter, which decides where a window is cut.

    Args:
        example: is left as it is.
        augmentation: how much of what.
        skeleton: of the directions.
        num_speakers: of the training split.
        rng: the same one gives the same example.
    """
    if augmentation.mirror and rng.random() < augmentation.mirror:
        example = mirror_example(example, skeleton, num_speakers)
    if "mel" not in example:
        return example
    mel = example["mel"]
    if augmentation.noise and rng.random() < augmentation.noise:
        mel = add_noise(mel, rng.uniform(*augmentation.noise_snr_db), rng)
    if augmentation.gain_db:
        mel = make_quieter(mel, rng.uniform(0, augmentation.gain_db))
    return example | {"mel": mel}


def mirror_example(example: dict[str, Any], skeleton: Skeleton, num_speakers: int) -> dict[str, Any]:
    """The example as a mirror shows it: the same words by another person, whose other hand moves.

    Joint angles are those of the other side; those with a palm normal, a cross product that a mirror turns over,
    are pi minus those of the other side.

    Args:
        example: has "directions", "speaker" and, where identities come from images, "images".
        skeleton: of the directions.
        num_speakers: of the training split; the mirror image of speaker i is speaker i + `num_speakers`.
    """
    mirrored = {
        "directions": mirror_directions(skeleton, example["directions"]),
        "speaker": np.int32(example["speaker"] + num_speakers),
    }
    if "images" in example:
        mirrored["images"] = example["images"][:, :, ::-1]
    return example | mirrored


def make_quieter(mel: np.ndarray, gain_db: float) -> np.ndarray:
    """The spectrogram of the same speech, `gain_db` >= 0 dB quieter.

    A gain above 0 has no meaning here: 0 dB is the maximum of the clip (D11).
    """
    return np.maximum(mel - np.float32(gain_db), np.float32(FLOOR_DB))


def add_noise(mel: np.ndarray, snr_db: float, rng: np.random.Generator) -> np.ndarray:
    """The spectrogram of the same speech with white noise.

    Powers are added, log10(10^(mel / 10) + 10^(noise / 10)). That is the spectrogram of the sum of both sounds but
    for the cross term of each bin, whose mean is 0.

    Args:
        mel: (128, 70) dB of a window.
        snr_db: mean power of this window's sound over that of the noise.
        rng: chooses the noise.

    Returns:
        (128, 70) float32 in [-80, 0]. A window without any sound has no power to compare with and stays as it is.
    """
    if mel.max() <= FLOOR_DB:
        return mel
    noise = _white_noise()
    start = rng.integers(noise.shape[1] - WINDOW_COLUMNS + 1)
    power = np.power(10, mel / 10)
    level = sound_power(power) * np.power(10, -snr_db / 10)
    noisy = power + np.float32(level) * noise[:, start : start + WINDOW_COLUMNS]
    return np.clip(10 * np.log10(noisy), FLOOR_DB, 0, dtype=np.float32)


def sound_power(power: np.ndarray) -> float:
    """The mean power of a sound, up to a factor, from its mel powers (128, columns).

    A band holds power per hertz (Slaney's area normalisation), so it counts by its width.
    """
    edges = librosa().mel_frequencies(NUM_MELS + 2, fmin=0, fmax=SAMPLE_RATE / 2)
    widths = edges[2:] - edges[:-2]
    return float(widths @ power.mean(axis=1) / widths.sum())


@functools.cache
def _white_noise() -> np.ndarray:
    """The mel powers of white noise, (128, columns) float32, whose `sound_power` is 1."""
    samples = np.random.default_rng(0).normal(size=_NOISE_SECONDS * SAMPLE_RATE).astype(np.float32)
    power = np.power(10, log_mel(samples)[:, 2:-2] / 10)  # columns at the ends hear reflections
    return power / np.float32(sound_power(power))
