"""Data augmentation of training windows (see `Windows`): pure functions that take a random number generator."""

import functools
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.spectrum import (
    FLOOR_DB,
    HOP_LENGTH,
    NUM_MELS,
    hide_unheard,
    log_mel,
    mel_frequencies,
    sound_power,
)
from ha2g_jax.features.text import PADDING
from ha2g_jax.skeleton import Skeleton, mirror_directions

_NOISE_SECONDS = 16
_BANDS = mel_frequencies(NUM_MELS + 2)[1:-1]  # Hz, centres of the bands of a spectrogram
_HIGHEST_FORMANT = 4800.0  # Hz
_EQUALIZER_POINTS = 6  # points of a random frequency response, evenly spaced in mel
_REVERBERATION_SECONDS = (0.2, 0.9)  # time in which the sound of a room falls by 60 dB
_DIRECT_DB = (0.0, 15.0)  # power of the direct sound over that of its reverberation


class Augmentation(NamedTuple):
    """Random changes of a training window, none by default; the table of settings, `config.data`, explains them."""

    jitter: int = 0
    mirror: float = 0.0
    vocal_tract: float = 0.0
    equalizer_db: float = 0.0
    reverb: float = 0.0
    gain_db: float = 0.0
    noise: float = 0.0
    noise_snr_db: tuple[float, float] = (10.0, 40.0)
    lookahead: float = 0.0
    least_heard: int = 1


def augment(
    example: dict[str, Any],
    augmentation: Augmentation,
    skeleton: Skeleton,
    num_speakers: int,
    rng: np.random.Generator,
    *,
    clip_power: float,
    start_frame: int,
    fps: float,
) -> dict[str, Any]:
    """Apply all random changes except the jitter, which is applied when the window is cut.

    The end of the speech is hidden last, so that no other change reaches it, and drawn last, so that the other changes
    do not depend on it. The example, see `Windows`, is not changed. `start_frame` is the first frame of the window in
    its clip, `clip_power` the `sound_power` of the clip, `num_speakers` the number of speakers of the training split.
    """
    if augmentation.mirror and rng.random() < augmentation.mirror:
        example = mirror_example(example, skeleton, num_speakers)
    if "mel" not in example:
        return example
    mel = example["mel"]
    if augmentation.vocal_tract:
        mel = warp_formants(mel, float((1 + augmentation.vocal_tract) ** rng.uniform(-1, 1)))
    if augmentation.equalizer_db:
        mel = equalize(mel, augmentation.equalizer_db, rng)
    if augmentation.reverb and rng.random() < augmentation.reverb:
        mel = reverberate(mel, rng.uniform(*_REVERBERATION_SECONDS), rng.uniform(*_DIRECT_DB))
    if augmentation.noise and rng.random() < augmentation.noise:
        snr_db = rng.uniform(*augmentation.noise_snr_db)
        mel = add_noise(mel, clip_power * 10 ** (-snr_db / 10), rng)
    if augmentation.gain_db:
        mel = make_quieter(mel, rng.uniform(0, augmentation.gain_db))
    example = example | {"mel": mel}
    if augmentation.lookahead and rng.random() < augmentation.lookahead:
        heard = int(rng.integers(augmentation.least_heard, len(example["directions"])))
        example = hide_end(example, start_frame, heard, fps)
    return example


def mirror_example(example: dict[str, Any], skeleton: Skeleton, num_speakers: int) -> dict[str, Any]:
    """Mirror an example: the same words by another speaker, with left and right exchanged.

    Joint angles become those of the other side. Angles with a palm normal, a cross product whose sign a reflection
    reverses, become pi minus those of the other side. The mirror image of speaker i of the training split is speaker
    i + `num_speakers`.
    """
    mirrored = {
        "directions": mirror_directions(skeleton, example["directions"]),
        "speaker": np.int32(example["speaker"] + num_speakers),
    }
    if "images" in example:
        mirrored["images"] = example["images"][:, :, ::-1]
    return example | mirrored


def warp_formants(mel: np.ndarray, factor: float) -> np.ndarray:
    """Move the formants of a spectrogram (128, columns) in dB, as with a vocal tract of another length.

    VTLP (Jaitly and Hinton 2013): frequencies f become `factor` f up to about 4.8 kHz, `factor` above 1 for a shorter
    vocal tract; those above are moved linearly, so that the highest one stays. Harmonics of the voice move with the
    formants. Values in dB are interpolated between bands.
    """
    highest, border = SAMPLE_RATE / 2, _HIGHEST_FORMANT * min(factor, 1.0)
    source = np.interp(_BANDS, [0, border, highest], [0, border / factor, highest])
    position = np.interp(source, _BANDS, np.arange(NUM_MELS))
    lower = np.minimum(position.astype(int), NUM_MELS - 2)
    share = (position - lower)[:, None].astype(np.float32)
    return (1 - share) * mel[lower] + share * mel[lower + 1]


def equalize(mel: np.ndarray, most_db: float, rng: np.random.Generator) -> np.ndarray:
    """Change the frequency response of a spectrogram (128, columns) in dB, as with another microphone.

    The response is interpolated between random values of at most `most_db` dB at six points, evenly spaced in mel. Its
    maximum is 0 dB, because the maximum of a clip is at most 0 dB (D11).
    """
    points = rng.uniform(-most_db, most_db, _EQUALIZER_POINTS)
    response = np.interp(np.linspace(0, _EQUALIZER_POINTS - 1, len(mel)), np.arange(_EQUALIZER_POINTS), points)
    return np.maximum(mel + (response - response.max())[:, None], FLOOR_DB).astype(np.float32)


def reverberate(mel: np.ndarray, seconds: float, direct_db: float) -> np.ndarray:
    """Add the reverberation of a room to the speech of a spectrogram (128, columns) in dB.

    To the power p of each column is added r sum_k d^k p[t - k] / sum_k d^k over the columns before it, where d^k falls
    by 60 dB in `seconds`. Powers add, as in `add_noise`; what was spoken before the window leaves no trace. `direct_db`
    is the power of the direct sound over that of its reverberation, -10 log10 r.
    """
    from scipy import signal  # its import takes most of a second in each process, and most runs need it nowhere else

    decay = 10 ** (-6 * HOP_LENGTH / SAMPLE_RATE / seconds)
    power = np.power(10, mel.astype(np.float64) / 10)
    tail = np.asarray(signal.lfilter([0, 1 - decay], [1, -decay], power))
    return np.clip(10 * np.log10(power + tail * 10 ** (-direct_db / 10)), FLOOR_DB, 0).astype(np.float32)


def make_quieter(mel: np.ndarray, gain_db: float) -> np.ndarray:
    """Make the sound of a spectrogram quieter, never louder, because the maximum of a clip is at most 0 dB (D11)."""
    return np.maximum(mel - np.float32(gain_db), np.float32(FLOOR_DB))


def add_noise(mel: np.ndarray, noise_power: float, rng: np.random.Generator) -> np.ndarray:
    """Add white noise of a mean power (see `sound_power`) to a spectrogram (128, columns) in dB, including its pauses.

    Powers are added, log10(10^(mel / 10) + 10^(noise / 10)). This is the spectrogram of the sum of both sounds except
    for the cross term of each bin, whose mean is 0.
    """
    noise = _white_noise()
    start = rng.integers(noise.shape[1] - mel.shape[1] + 1)
    noisy = np.power(10, mel / 10) + np.float32(noise_power) * noise[:, start : start + mel.shape[1]]
    return np.clip(10 * np.log10(noisy), FLOOR_DB, 0, dtype=np.float32)


def hide_end(example: dict[str, Any], start_frame: int, heard: int, fps: float) -> dict[str, Any]:
    """Hide the speech of an example, its mel and its words, from frame `heard` of the window on, as in a stream."""
    hidden = {"mel": hide_unheard(example["mel"], start_frame, heard, fps)}
    if "words" in example:
        is_heard = np.arange(len(example["words"])) < heard
        hidden["words"] = np.where(is_heard, example["words"], np.int32(PADDING))
    return example | hidden


@functools.cache
def _white_noise() -> np.ndarray:
    """Return the mel powers of white noise, (128, columns) float32, whose `sound_power` is 1."""
    samples = np.random.default_rng(0).normal(size=_NOISE_SECONDS * SAMPLE_RATE).astype(np.float32)
    power = np.power(10, log_mel(samples)[:, 2:-2] / 10)  # columns at the ends are silence
    return power / np.float32(sound_power(power))
