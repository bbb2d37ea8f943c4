"""Beat consistency (BC) as the paper has it (HA2G, Eq. 10, 11 and 13, supplement E), on clips of any length.

BC asks only whether each onset has a motion beat near it. Jitter, which has a motion beat everywhere, scores highest,
so that BC is read beside the number of motion beats, and `alignment` has the score to report. Where the paper is
silent: motion beats are minima and lie between the two frames that the change is of, onsets of all clips have one vote
each, and a motionless clip counts as 0. `legacy_bc` leaves such clips out, and has the windows and frames of the public
release.
"""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.metrics.beats.alignment import Alignment, align
from ha2g_jax.metrics.beats.stops import FIRST_FRAME, THRESHOLD, Clip
from ha2g_jax.metrics.beats.times import SIGMA


def low_samples(rate: np.ndarray, threshold: float) -> np.ndarray:
    """Return the indices of samples below both neighbours, and below at least one of them by the threshold.

    Args:
        rate: (n,) angle change rate.
        threshold: least rise to the next sample on either side.
    """
    before, after = rate[:-2] - rate[1:-1], rate[2:] - rate[1:-1]
    is_low = (before > 0) & (after > 0) & ((before >= threshold) | (after >= threshold))
    return 1 + np.flatnonzero(is_low)


def consistency(
    rates: Sequence[np.ndarray] | np.ndarray,
    onsets: Sequence[np.ndarray],
    fps: float | np.ndarray,
    *,
    first_frame: int = FIRST_FRAME,
    threshold: float = THRESHOLD,
    sigma: float = SIGMA,
) -> Alignment:
    """Align clips by the motion beats of the paper; BC is the sum of `onset_sum` over the sum of `num_onsets`.

    Args:
        rates: (T - 1,) angle change rate of each clip, from `angle_change_rates`.
        onsets: (k,) onsets of each clip in seconds from frame 0.
        fps: frames per second, of all clips or (n,).
        first_frame: first frame that is looked at.
        threshold: least rise of the rate to the next frame, on either side of a motion beat.
        sigma: width of the kernel in seconds.
    """
    clips = []
    for curve, sounds, rate in zip(rates, onsets, np.broadcast_to(fps, len(rates)).tolist(), strict=True):
        samples = first_frame + low_samples(curve[first_frame:], threshold)
        clips.append(Clip((samples + 0.5) / rate, sounds, first_frame / rate, (len(curve) + 1) / rate))
    return align(clips, sigma=sigma)


def beat_consistency(alignment: Alignment) -> float:
    """Return BC, the mean of the kernel over the onsets of all clips; NaN without an onset."""
    count = int(alignment.num_onsets.sum())
    return float(alignment.onset_sum.sum() / count) if count else float("nan")
