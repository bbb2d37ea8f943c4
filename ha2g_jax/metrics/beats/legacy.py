"""Beat consistency (BC) by the rules of the public release, with their faults, for comparison with published numbers.

The rules measure recall of the onsets alone, leave motionless clips out, score white jitter highest, and their
constants and frames hold for windows of 34 frames at 15 fps. `alignment` has the corrected score.

Two variants: "paper" takes the angles of mean-subtracted vectors, as the published numbers were made, "fixed" those of
the poses. The constants (mean absolute angle changes) are of the poses in both. One thing is not as it was: angles of
rigid parts are left out, where the rule divides by their rounding; the TED skeletons have none.
"""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.metrics.beats.angle_change import angle_change_rates
from ha2g_jax.metrics.beats.consistency import low_samples
from ha2g_jax.metrics.beats.times import kernel, nearest
from ha2g_jax.skeleton import Skeleton

VARIANTS = ("paper", "fixed")
NUM_FRAMES = 34
FPS = 15
SIGMA = 0.1  # seconds
THRESHOLD = 0.03


def legacy_bc(
    skeleton: Skeleton,
    directions: np.ndarray,
    onsets: Sequence[np.ndarray],
    *,
    variant: str = "paper",
    threshold: float = THRESHOLD,
) -> float:
    """Compute the mean over the onsets of all clips with motion beats of exp(-d^2 / (2 0.1^2)), d to the nearest beat.

    Args:
        skeleton: skeleton with mean directions, angle pairs and mean absolute angle changes.
        directions: (n, 34, bones, 3) restored direction vectors, mean included; the seed poses are scored too. A
            network's published numbers need the output as it is, not scaled to unit length.
        onsets: (k,) onsets of each window in seconds, by librosa's detector with all defaults on 36267 samples.
        variant: "paper" or "fixed".
        threshold: least rise of the rate to the next frame, on either side.

    Returns:
        The score; NaN where no clip has a motion beat.

    Raises:
        UserError: other windows than 34 frames, another variant, or a clip with motion beats and without onsets, where
            the rule divides by zero.
    """
    if variant not in VARIANTS:
        raise UserError(f"legacy beat consistency has no variant {variant!r}; choose one of {', '.join(VARIANTS)}")
    if directions.ndim != 4 or directions.shape[1] != NUM_FRAMES:
        raise UserError(
            f"legacy beat consistency got motion of shape {directions.shape}; it is defined on windows of {NUM_FRAMES} "
            "frames at 15 fps, (n, 34, bones, 3)"
        )
    if len(onsets) != len(directions):
        raise UserError(f"legacy beat consistency got {len(directions)} windows and {len(onsets)} lists of onsets")
    mean = skeleton.mean_directions if variant == "paper" else np.zeros_like(skeleton.mean_directions)
    rates = angle_change_rates(skeleton, (clip - mean[None] for clip in directions))
    total, count = 0.0, 0
    for number, (rate, sounds) in enumerate(zip(rates, onsets, strict=True)):
        found = legacy_motion_beats(rate, threshold)
        if not len(found):
            continue
        if not len(sounds):
            raise UserError(
                f"clip {number} has motion beats but no onsets, and the legacy rule divides by their number; leave "
                "silent clips out, or use the default beat alignment, which counts them"
            )
        total += float(kernel(nearest(np.sort(sounds), found), SIGMA).sum())
        count += len(sounds)
    return total / count if count else float("nan")


def legacy_motion_beats(rate: np.ndarray, threshold: float = THRESHOLD) -> np.ndarray:
    """Return the times t / 15 of the frames t = 2 to 32 whose rate is below its neighbours, once by the threshold.

    Args:
        rate: (33,) rates of the changes from frame t - 1 to frame t = 1 to 33.
        threshold: least rise of the rate.
    """
    return (1 + low_samples(rate, threshold)) / FPS
