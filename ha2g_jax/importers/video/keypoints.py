"""Conversion of MediaPipe's landmarks to the 43 keypoints of TED-Expressive (HA2G, Appendix A).

MediaPipe's world landmarks are in metres around the middle of the hips, x to the right of the image, y down, z away
from the camera, which are the axes of TED-Expressive for a person who faces the camera. Hands are in pixels, with a
depth in the same unit; the size of the palm gives the number of pixels in a metre.
"""

from typing import NamedTuple

import numpy as np

from ha2g_jax.skeleton import Skeleton, load_skeleton

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


class Keypoints(NamedTuple):
    """Keypoints of the speaker in each image.

    Attributes:
        positions: (T, 43, 3) float32 metres in the axes of TED-Expressive, NaN where unseen.
        confidence: (T, 43) float32 in [0, 1], 0 where unseen.
        image_points: (T, 43, 2) float32 pixels, NaN where unseen.
    """

    positions: np.ndarray
    confidence: np.ndarray
    image_points: np.ndarray


def from_holistic(
    world: np.ndarray, image: np.ndarray, left_hand: np.ndarray, right_hand: np.ndarray, sizes: np.ndarray
) -> Keypoints:
    """Convert the landmarks of MediaPipe Holistic to keypoints.

    A hand that was found is attached to the wrist of the body, whose position in the image may differ slightly. The
    spine keypoint is inside the chest. It has the confidence of the shoulders if it lies in the image, so that a
    speaker behind a desk counts as visible; otherwise it has that of the hips.

    Args:
        world: (T, 33, 4) position in metres, and visibility, of the landmarks of the body.
        image: (T, 33, 2) landmarks of the body in pixels.
        left_hand: (T, 21, 3) landmarks of the left hand in pixels, with depth in the same unit.
        right_hand: (T, 21, 3) landmarks of the right hand in pixels, with depth in the same unit.
        sizes: (T, 2) width and height of the images in pixels.
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
    """Set neck and spine, in metres or in pixels."""
    left, right = (landmarks[:, index] for index in _SHOULDERS)
    shoulders, hips = (left + right) / 2, landmarks[:, _HIPS].mean(axis=1)
    up = _unit(shoulders - hips)
    half = np.linalg.norm(left - right, axis=-1, keepdims=True) / 2
    neck = shoulders + _NECK_RISE * half * up
    if landmarks.shape[-1] == 3:
        neck += _NECK_BACK * half * _unit(np.cross(up, left - right))
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


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-8)
