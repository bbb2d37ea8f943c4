"""What models hear of a clip, prepared once, and what they hear of one of its windows.

Training and synthesis both take their inputs from here, so that a window of a long recording is heard as it would be
in training.
"""

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.features.asr_mel import asr_log_mel, asr_window
from ha2g_jax.features.audio import log_mel, mel_window, wave_window
from ha2g_jax.features.text import Vocabulary, Word, plain_words, words_to_frames


class Speech(NamedTuple):
    """A clip as models hear it.

    Attributes:
        tracks: by name of the input, what it is cut from: "mel" (128, columns) float16 dB, "asr_mel" (80, columns)
            float16, "audio" (samples,) float32; half precision is finer than 0.07 dB.
        words: in order of time.
        starts, ends: (n,) their times in seconds, in ascending order.
    """

    tracks: dict[str, np.ndarray]
    words: tuple[Word, ...]
    starts: np.ndarray
    ends: np.ndarray

    @property
    def num_bytes(self) -> int:
        """Of memory."""
        return sum(track.nbytes for track in self.tracks.values()) + 200 * len(self.words)  # text and two floats


# Inputs that are cut from a track: how that is made of the samples, and how a window (start frame, fps) is cut.
_TRACKS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], Callable[..., np.ndarray]]] = {
    # librosa lays the columns of a spectrogram one after the other; batches want rows.
    "mel": (lambda audio: log_mel(audio).astype(np.float16, order="C"), mel_window),
    "asr_mel": (lambda audio: asr_log_mel(audio).astype(np.float16, order="C"), asr_window),
    "audio": (lambda audio: np.asarray(audio, np.float32), wave_window),
}
INPUTS = (*_TRACKS, "words", "plain_words")


def prepare(audio: np.ndarray, words: Sequence[Word], inputs: Collection[str]) -> Speech:
    """The speech of a clip for windows of `inputs`, some of `INPUTS`.

    Args:
        audio: (samples,) float32 at 16 kHz.
        words: of the clip, in order of time.
        inputs: what models want to hear.
    """
    tracks = {name: make(audio) for name, (make, _) in _TRACKS.items() if name in inputs}
    for track in tracks.values():
        track.setflags(write=False)
    ends = np.maximum.accumulate([0.0, *(word.end for word in words)])[1:]
    return Speech(tracks, tuple(words), np.array([word.start for word in words]), ends)


def window(
    speech: Speech, inputs: Collection[str], vocabulary: Vocabulary, start: int, num_frames: int, fps: float
) -> dict[str, np.ndarray]:
    """The inputs of the window that starts at frame `start`, without a batch axis.

    Returns:
        name -> array: "mel" (128, 70) float32 dB, "asr_mel" (80, 228) float32, "audio" (36267,) float32, "words" (N,)
        int32 on frames, "plain_words" (32,) int32. What lies past the end of the clip is silence.
    """
    heard = {
        name: cut(speech.tracks[name], start, fps).astype(np.float32)
        for name, (_, cut) in _TRACKS.items()
        if name in inputs
    }
    # Only words near the window are laid out; a frame more on either side leaves rounding to the functions below.
    first = speech.ends.searchsorted((start - 1) / fps, "left")
    last = speech.starts.searchsorted((start + num_frames + 1) / fps, "right")
    words = speech.words[first:last]
    if "words" in inputs:
        heard["words"] = words_to_frames(words, vocabulary, start / fps, num_frames, fps)
    if "plain_words" in inputs:
        heard["plain_words"] = plain_words(words, vocabulary, start / fps, num_frames / fps)
    return heard
