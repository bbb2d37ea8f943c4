"""The 43 keypoints of TED-Expressive (HA2G, Appendix A): conversion of MediaPipe's landmarks, and cleaning.

MediaPipe's world landmarks are in metres around the middle of the hips, x to the right of the image, y down, z away
from the camera, which are the axes of TED-Expressive for a person who faces the camera. Hands are in pixels, with a
depth in the same unit; the size of the palm gives the number of pixels in a metre.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from ha2g_jax.skeleton import (
    Skeleton,
    bone_lengths,
    directions_to_positions,
    load_skeleton,
    normalize,
    positions_to_directions,
)

# Indices of MediaPipe's pose landmarks.
_BODY = {
    "left_shoulder": 11,
    "right_shoulder": 12,
    "left_elbow": 13,
    "right_elbow": 14,
    "left_wrist": 15,
    "right_wrist": 16,
    "nose": 0,
    "left_eye": 2,
    "right_eye": 5,
    "left_ear": 7,
    "right_ear": 8,
}
_SHOULDERS, _HIPS = (11, 12), (23, 24)
# The first three of the four landmarks of each finger among MediaPipe's 21 hand landmarks; 0 is the wrist.
_FINGERS = {"thumb": (1, 2, 3), "index": (5, 6, 7), "middle": (9, 10, 11), "ring": (13, 14, 15), "pinky": (17, 18, 19)}
_KNUCKLES = (5, 9, 13, 17)
_PALM = 0.088  # metres from the wrist to a knuckle, mean of the four knuckles of an adult
# Position of the neck above and behind the middle of the shoulders, as fractions of half their distance: the mean
# directions of TED-Expressive from neck to shoulder are (0.9, 0.27, -0.1) to either side.
_NECK_RISE, _NECK_BACK = 0.3, 0.1
# Position of the spine keypoint between shoulders (0) and hips (1). With a torso of 0.5 m it lies 0.25 m below the
# neck; the mean bone of TED-Expressive is 0.26 m long.
_SPINE = 0.4

_ORDER = 2  # order of the low-pass filter, which runs forwards and backwards
_GLIMPSE_FRAMES = 3
_MEDIAN_FRAMES = 5
# A jump exceeds both this distance from the median of its neighbours, in metres, and this multiple of their spread.
_MIN_JUMP, _SPREADS = 0.03, 4.5


class Keypoints(NamedTuple):
    """Keypoints of the speaker, one pose for each image."""

    positions: np.ndarray  # (T, 43, 3) float32 metres in the axes of TED-Expressive, NaN where unseen
    confidence: np.ndarray  # (T, 43) float32 in [0, 1], 0 where unseen
    image_points: np.ndarray  # (T, 43, 2) float32 pixels, NaN where unseen


def from_holistic(
    world: np.ndarray, image: np.ndarray, left_hand: np.ndarray, right_hand: np.ndarray, sizes: np.ndarray
) -> Keypoints:
    """Convert the landmarks of MediaPipe Holistic, see the docstring of `holistic`, to keypoints.

    A hand that was found is attached to the wrist of the body, whose position in the image may differ slightly. The
    spine keypoint is inside the chest. It has the confidence of the shoulders if it lies in the image, so that a
    speaker behind a desk counts as visible; otherwise it has that of the hips.
    """
    skeleton = load_skeleton("ted_expressive")
    visibility = np.nan_to_num(world[..., 3])
    positions = np.full((len(world), skeleton.num_joints, 3), np.nan, np.float32)
    points = np.full((len(world), skeleton.num_joints, 2), np.nan, np.float32)
    confidence = np.zeros((len(world), skeleton.num_joints), np.float32)
    for name, landmark in _BODY.items():
        joint = skeleton.joint(name)
        positions[:, joint] = world[:, landmark, :3]
        points[:, joint] = image[:, landmark]
        confidence[:, joint] = visibility[:, landmark]
    _add_torso(skeleton, positions, world[..., :3])
    _add_torso(skeleton, points, image)
    spine, neck = skeleton.joint("spine"), skeleton.joint("neck")
    is_inside = ((points[:, spine] >= 0) & (points[:, spine] < sizes)).all(axis=-1)
    confidence[:, neck] = visibility[:, _SHOULDERS].min(axis=1)
    confidence[:, spine] = np.where(is_inside, confidence[:, neck], visibility[:, _HIPS].min(axis=1))
    for side, hand in (("left", left_hand), ("right", right_hand)):
        _add_hand(skeleton, side, hand, positions, confidence, points)
    return Keypoints(positions, confidence, points)


def _add_torso(skeleton: Skeleton, out: np.ndarray, landmarks: np.ndarray) -> None:
    left, right = (landmarks[:, index] for index in _SHOULDERS)
    shoulders, hips = (left + right) / 2, landmarks[:, _HIPS].mean(axis=1)
    up = normalize(shoulders - hips)
    half = np.linalg.norm(left - right, axis=-1, keepdims=True) / 2
    neck = shoulders + _NECK_RISE * half * up
    if landmarks.shape[-1] == 3:
        neck += _NECK_BACK * half * normalize(np.cross(up, left - right))
    out[:, skeleton.joint("neck")] = neck
    out[:, skeleton.joint("spine")] = shoulders + _SPINE * (hips - shoulders)


def _add_hand(
    skeleton: Skeleton,
    side: str,
    hand: np.ndarray,
    positions: np.ndarray,
    confidence: np.ndarray,
    points: np.ndarray,
) -> None:
    """Set the fingers of one hand, relative to the wrist of the body."""
    wrist = skeleton.joint(f"{side}_wrist")
    from_wrist = hand - hand[:, :1]
    palm = np.linalg.norm(from_wrist[:, _KNUCKLES], axis=-1).mean(axis=1)
    is_found = np.isfinite(palm) & (palm > 0) & np.isfinite(positions[:, wrist]).all(axis=-1)
    metres = from_wrist[is_found] * (_PALM / palm[is_found, None, None])
    for finger, landmarks in _FINGERS.items():
        for number, landmark in enumerate(landmarks, 1):
            joint = skeleton.joint(f"{side}_{finger}_{number}")
            positions[is_found, joint] = positions[is_found, wrist] + metres[:, landmark]
            points[is_found, joint] = hand[is_found, landmark, :2]
            confidence[is_found, joint] = 1
    confidence[is_found, wrist] = 1  # the wrist is part of the hand that was found


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
    from scipy import signal  # its import takes most of a second, in the process of each video, used or not

    if len(values) < 2:
        return values
    sections = signal.butter(_ORDER, cutoff, fs=fps, output="sos")
    longest = round(3 * fps / cutoff)  # time in which the response to the padding decays
    return signal.sosfiltfilt(sections, values, axis=0, padlen=min(longest, len(values) - 1))


def _bone_lengths(skeleton: Skeleton, positions: np.ndarray) -> np.ndarray:
    """Return the median lengths (bones,) over the shot and both sides; the skeleton's length if neither was seen."""
    lengths = bone_lengths(skeleton, positions)
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
