"""Removal of gaps, jumps and jitter from the poses of one shot."""

import numpy as np
from scipy import ndimage, signal
from scipy.spatial.transform import Rotation

from ha2g_jax.skeleton import Skeleton, directions_to_positions, load_skeleton, normalize, positions_to_directions

_ORDER = 2  # order of the low-pass filter, which runs forwards and backwards
_GLIMPSE_FRAMES = 3
_MEDIAN_FRAMES = 5
# A jump exceeds both this distance from the median of its neighbours, in metres, and this multiple of their spread.
_MIN_JUMP, _SPREADS = 0.03, 4.5


def clean(
    positions: np.ndarray, confidence: np.ndarray, fps: float, *, max_gap: float = 0.5, cutoff: float = 5.0
) -> np.ndarray:
    """Make poses complete, steady and of constant bone lengths.

    1. A keypoint that jumps away for one or two frames and returns (Hampel filter), or that is seen for only one or two
       frames between two gaps, is an error of the estimator and counts as unseen.
    2. Each keypoint is taken relative to its parent joint, and fingers also relative to the direction of the forearm,
       so that an unseen hand keeps its shape and moves with the arm.
    3. A gap of at most `max_gap` is interpolated linearly. In a longer gap the last value is held, and interpolated
       only in the last `max_gap`, because people do not drift slowly. At the ends of the shot the nearest value is
       held. A keypoint that is never seen has its place in the skeleton's mean pose.
    4. A Butterworth low-pass filter runs forwards and backwards, so that it does not delay strokes.
    5. Bones get their median length over the shot, averaged over left and right, because the estimated length varies
       with depth. The directions, which the model learns, stay.

    Args:
        positions: (T, 43, 3) metres, NaN where unseen.
        confidence: (T, 43), 0 where unseen.
        fps: frames per second.
        max_gap: longest gap that is interpolated, in seconds.
        cutoff: frequency at which the amplitude is halved, in hertz; no filter from half the frame rate on.

    Returns:
        (T, 43, 3) float32, finite.
    """
    skeleton = load_skeleton("ted_expressive")
    is_seen = _without_glimpses((confidence > 0) & np.isfinite(positions).all(axis=-1))
    positions = np.where(is_seen[..., None], positions, np.nan).astype(np.float64)
    if not len(positions):
        return positions.astype(np.float32)
    lengths = _bone_lengths(skeleton, positions)
    positions = _fill(skeleton, positions, lengths, max(1, round(max_gap * fps)))
    if cutoff < fps / 2:
        positions = _low_pass(positions, fps, cutoff)
    root = positions[:, :1]
    offsets = positions_to_directions(skeleton, positions) * lengths[:, None]
    return (root + np.einsum("jb,tbc->tjc", skeleton.paths, offsets)).astype(np.float32)


def _fill(skeleton: Skeleton, positions: np.ndarray, lengths: np.ndarray, max_gap: int) -> np.ndarray:
    """Apply steps 1 to 3, which give finite positions."""
    rest = directions_to_positions(skeleton, skeleton.mean_directions.astype(np.float64))
    rest_offsets = positions_to_directions(skeleton, rest) * lengths[:, None]
    filled = np.empty_like(positions)
    filled[:, 0] = _interpolate(_without_jumps(positions[:, 0]), np.zeros(3), max_gap)
    for bone in _from_root(skeleton):
        parent, child = skeleton.bones[bone]
        offsets, resting = positions[:, child] - positions[:, parent], rest_offsets[bone]
        name = skeleton.joints[child]
        if not name.endswith(("_1", "_2", "_3")):
            filled[:, child] = filled[:, parent] + _interpolate(_without_jumps(offsets), resting, max_gap)
            continue
        forearm = skeleton.bone(f"{name.split('_')[0]}_wrist")
        elbow, wrist = skeleton.bones[forearm]
        rotations = _rotations(np.concatenate([filled[:, wrist] - filled[:, elbow], rest_offsets[None, forearm]]))
        rotations, at_rest = rotations[:-1], rotations[-1]
        shapes = _interpolate(_without_jumps(rotations.inv().apply(offsets)), at_rest.inv().apply(resting), max_gap)
        filled[:, child] = filled[:, parent] + rotations.apply(shapes)
    return filled


def _without_glimpses(is_seen: np.ndarray) -> np.ndarray:
    """Remove seen keypoints (T, joints) that last only one or two frames, which are errors of the estimator."""
    frames = np.ones((_GLIMPSE_FRAMES, 1))
    lasting = ndimage.binary_dilation(ndimage.binary_erosion(is_seen, frames, border_value=1), frames)
    return np.where(lasting.any(axis=0), lasting & is_seen, is_seen)


def _without_jumps(values: np.ndarray) -> np.ndarray:
    """Set values (T, 3) to NaN that lie away from their neighbours in time."""
    if len(values) < _MEDIAN_FRAMES:
        return values
    reach = _MEDIAN_FRAMES // 2
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, _MEDIAN_FRAMES, axis=0)  # (T, 3, frames)
    with np.errstate(invalid="ignore"):
        median = np.median(windows, axis=-1)  # NaN if a neighbour is unseen, so that the value is kept
        spread = np.median(np.linalg.norm(windows - median[..., None], axis=1), axis=-1)
        jumps = np.linalg.norm(values - median, axis=-1) > np.maximum(_MIN_JUMP, _SPREADS * spread)
    return np.where(jumps[:, None], np.nan, values)


def _interpolate(values: np.ndarray, resting: np.ndarray, max_gap: int) -> np.ndarray:
    """Fill NaN in values (T, 3) as in step 3 of `clean`; gaps in frames."""
    seen = np.flatnonzero(np.isfinite(values).all(axis=-1))
    if not len(seen):
        return np.tile(resting, (len(values), 1))
    # In a long gap, the first value is repeated shortly before its end.
    long = np.flatnonzero(np.diff(seen) - 1 > max_gap)
    stated = np.insert(seen, long + 1, seen[long + 1] - max_gap - 1)
    held = np.insert(values[seen], long + 1, values[seen[long]], axis=0)
    frames = np.arange(len(values))
    return np.stack([np.interp(frames, stated, held[:, axis]) for axis in range(values.shape[1])], axis=1)


def _low_pass(values: np.ndarray, fps: float, cutoff: float) -> np.ndarray:
    """Filter along the first axis, without delay; -6 dB at the cutoff for the two passes together."""
    if len(values) < 2:
        return values
    sections = signal.butter(_ORDER, cutoff, fs=fps, output="sos")
    longest = round(3 * fps / cutoff)  # time in which the response to the padding decays
    return signal.sosfiltfilt(sections, values, axis=0, padlen=min(longest, len(values) - 1))


def _bone_lengths(skeleton: Skeleton, positions: np.ndarray) -> np.ndarray:
    """Return the median lengths (bones,) over the shot and both sides; the skeleton's length if neither was seen."""
    parents, children = (list(ends) for ends in zip(*skeleton.bones, strict=True))
    lengths = np.linalg.norm(positions[:, children] - positions[:, parents], axis=-1)
    medians = np.array([np.median(seen) if len(seen := bone[np.isfinite(bone)]) else np.nan for bone in lengths.T])
    both = np.stack([medians, medians[skeleton.mirror_bones]])
    count = np.isfinite(both).sum(axis=0)
    return np.where(count > 0, np.nansum(both, axis=0) / np.maximum(count, 1), skeleton.lengths)


def _rotations(directions: np.ndarray) -> Rotation:
    """Return the shortest rotation from the mean of directions (N, 3) to each of them."""
    directions = normalize(directions)
    mean = normalize(directions.mean(axis=0))
    axes = np.cross(mean, directions)
    sines = np.linalg.norm(axes, axis=-1, keepdims=True)
    angles = np.arctan2(sines, (directions @ mean)[:, None])
    return Rotation.from_rotvec(angles * axes / np.maximum(sines, 1e-12))


def _from_root(skeleton: Skeleton) -> list[int]:
    """Return the bones, each after its parent bone."""
    return sorted(range(skeleton.num_bones), key=lambda bone: skeleton.paths[skeleton.bones[bone][1]].sum())
