"""Beats of a motion for recorded speech, where no stroke is known: do the hands strike at the onsets of the sound?"""

import itertools
import pathlib
from typing import Any

import numpy as np

from ha2g_jax import synthesis
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.metrics import beats
from ha2g_jax.metrics.jackknife import jackknife
from ha2g_jax.study.talk.scores import row_as_json

MIN_SECONDS = 10.0  # of a recording
SEGMENT = 5.0  # seconds that the recording is cut into for the standard error
SHIFT = 2.0  # seconds between the shifts that make the floor; the first is twice that


def evaluate_recording(
    checkpoint: str | pathlib.Path, speech: str | pathlib.Path, *, speaker: str | None = None, seed: int = 0
) -> dict[str, Any]:
    """Beat alignment of the motion that a checkpoint makes for a recording.

    Args:
        checkpoint: "demo", a workdir or a model folder.
        speech: a file with sound.
        speaker: a speaker of the model for the style; drawn with `seed` by default.
        seed: of the style and the start pose.

    Returns:
        As `alignment_gain`.

    Raises:
        UserError: the checkpoint, the speech or the speaker cannot be used, or there are less than 10 s of speech.
    """
    audio = read_audio(speech)
    if len(audio) < MIN_SECONDS * SAMPLE_RATE:
        raise UserError(f"{speech} has {len(audio) / SAMPLE_RATE:.1f} s of sound; expected at least {MIN_SECONDS:g} s")
    model = synthesis.load(checkpoint)
    motion = model.generate(audio, style=synthesis.Style(speaker=speaker), seed=seed)
    wrists = beats.wrists(model.spec.skeleton, motion.directions)
    first_frame = model.spec.num_seed_frames
    return {"speech": pathlib.Path(speech).name} | alignment_gain(audio, wrists, motion.fps, first_frame)


def alignment_gain(audio: np.ndarray, wrists: np.ndarray, fps: float, first_frame: int = 4) -> dict[str, Any]:
    """Beat alignment with the sound, and its gain over the same motion with mismatched sound.

    The mismatched sound is the recording itself, turned round by 4, 6, 8, ... seconds: its rhythm is the same, its
    onsets are elsewhere. The standard error is by segments of 5 seconds.

    Args:
        audio: (samples,) at 16 kHz.
        wrists: (T, 2, 3) positions of the wrists in metres, y down.
        fps: frames per second.
        first_frame: frames before it are not scored.

    Returns:
        `alignment` (F), `mismatched` and `gain` as {"value", "error"}, `onsets_per_second` and `beats_per_second`.
        The first three are undefined in silence, the floor and the gain in less than 8 seconds.
    """
    start, end = first_frame / fps, min(len(audio) / SAMPLE_RATE, len(wrists) / fps)
    onsets, moves = (x[(x >= start) & (x < end)] for x in (beats.onsets(audio), beats.motion_beats(wrists, fps)))
    length = end - start
    shifts = np.arange(2 * SHIFT, length - 2 * SHIFT, SHIFT)
    sounds = [onsets, *(np.sort((onsets - start + shift) % length + start) for shift in shifts)]
    edges = np.linspace(start, end, max(1, round(length / SEGMENT)) + 1)
    sums = np.array([[beats.kernels(x, moves, *edge) for x in sounds] for edge in itertools.pairwise(edges)])
    if not len(onsets):
        sums = sums[:0]
    statistics = {
        "alignment": _own,
        "mismatched": _mismatched,
        "gain": lambda sums: _own(sums) - _mismatched(sums),
    }
    scores = {name: jackknife(sums, statistic, np.arange(len(sums))) for name, statistic in statistics.items()}
    rates = {"onsets_per_second": len(onsets) / length, "beats_per_second": len(moves) / length}
    return row_as_json(scores) | {name: round(rate, 3) for name, rate in rates.items()}


def _own(sums: np.ndarray) -> float:
    return beats.alignment(sums[:, 0])


def _mismatched(sums: np.ndarray) -> float:
    if sums.shape[1] < 2:
        return float("nan")
    return float(np.mean([beats.alignment(sums[:, shift]) for shift in range(1, sums.shape[1])]))
