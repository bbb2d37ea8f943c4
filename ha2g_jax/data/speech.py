"""Speech inputs of a model, in training and synthesis: features of a whole clip, computed once, and windows of them."""

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.features.audio import high_pass, wave_window
from ha2g_jax.features.spectrum import asr_log_mel, asr_window, log_mel, mel_window
from ha2g_jax.features.text import Vocabulary, Word, plain_words, words_to_frames


class Speech(NamedTuple):
    """Speech features of a clip.

    Attributes:
        tracks: features of the whole clip by name of the input: "mel" (128, columns) float16 dB, "asr_mel" (80,
            columns) float16, "audio" (samples,) float32; half precision is finer than 0.07 dB.
        starts, ends: (n,) start of each word, and latest end of the words up to it, in seconds; both ascend.
    """

    tracks: dict[str, np.ndarray]
    words: tuple[Word, ...]
    starts: np.ndarray
    ends: np.ndarray

    @property
    def num_bytes(self) -> int:
        """Size in memory, in bytes."""
        return sum(track.nbytes for track in self.tracks.values()) + 200 * len(self.words)  # text, two floats


# Inputs that are cut from a track: the function of the samples that computes it, and the function of (track, start
# frame, fps) that cuts a window.
_TRACKS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], Callable[..., np.ndarray]]] = {
    # librosa's spectrograms are in column-major order; batches need row-major order.
    "mel": (lambda audio: log_mel(audio).astype(np.float16, order="C"), mel_window),
    "asr_mel": (lambda audio: asr_log_mel(high_pass(audio)).astype(np.float16, order="C"), asr_window),
    "audio": (high_pass, wave_window),
}
INPUTS = (*_TRACKS, "words", "plain_words")


def prepare(audio: np.ndarray, words: Sequence[Word], inputs: Collection[str]) -> Speech:
    """Compute the features of a clip (samples,) at 16 kHz from which `window` cuts the inputs, names among `INPUTS`."""
    tracks = {name: make(audio) for name, (make, _) in _TRACKS.items() if name in inputs}
    for track in tracks.values():
        track.setflags(write=False)
    ends = np.maximum.accumulate([0.0, *(word.end for word in words)])[1:]
    return Speech(tracks, tuple(words), np.array([word.start for word in words]), ends)


def window(
    speech: Speech, inputs: Collection[str], vocabulary: Vocabulary, start: int, num_frames: int, fps: float
) -> dict[str, np.ndarray]:
    """Cut the inputs of one window of `num_frames` frames from frame `start` on, without a batch axis.

    They are a dict by name: "mel" (128, columns) float32 dB, "asr_mel" (80, columns) float32, "audio" (samples,)
    float32, "words" (N,) int32 on frames, "plain_words" (32,) int32. 34 frames at 15 fps have 70 columns of "mel", 228
    of "asr_mel" and 36,267 samples. Past the end of the clip there is silence.
    """
    cut_inputs = {
        name: cut(speech.tracks[name], start, num_frames, fps).astype(np.float32)
        for name, (_, cut) in _TRACKS.items()
        if name in inputs
    }
    # Only words near the window are used, with a margin of one frame, so that the functions below decide on rounding.
    first = speech.ends.searchsorted((start - 1) / fps, "left")
    last = speech.starts.searchsorted((start + num_frames + 1) / fps, "right")
    words = speech.words[first:last]
    if "words" in inputs:
        cut_inputs["words"] = words_to_frames(words, vocabulary, start / fps, num_frames, fps)
    if "plain_words" in inputs:
        cut_inputs["plain_words"] = plain_words(words, vocabulary, start / fps, num_frames / fps)
    return cut_inputs
