"""Statistics of the motion of a training split: bones, angles of the arms, speed of the wrists."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ha2g_jax.data.records import WINDOW_FRAMES, frames_at
from ha2g_jax.skeleton import Skeleton, joint_angles, load_skeleton, positions_to_directions

# Inner angles of TED-Expressive in degrees, with the values that the paper calls variances (HA2G, Table 10). They are
# neither the variances of the published data (49, 355, 44, 343) nor their roots, and are used as standard deviations.
TABLE_10 = {
    "left_shoulder": (116.6, 9.01),
    "right_shoulder": (127.1, 7.53),
    "left_elbow": (75.1, 7.30),
    "right_elbow": (85.3, 7.22),
}
ANGLE_EDGES = np.linspace(0, 180, 91)
SPEED_EDGES = np.linspace(0, 4, 161)  # m/s; the last bin includes higher speeds


class TrainingMotion:
    """Sums over the frames of a training split that lie in a window.

    Args:
        skeleton: skeleton of the corpus.
        fps: frames per second.
    """

    def __init__(self, skeleton: Skeleton, fps: float):
        self._skeleton, self._fps = skeleton, fps
        self._wrists = [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]
        self._joints = inner_angles(skeleton)
        self._histograms = {joint: np.zeros(len(ANGLE_EDGES) - 1, np.int64) for joint in self._joints}
        self._speeds = np.zeros(len(SPEED_EDGES) - 1, np.int64)
        self._speed = 0.0
        self._lengths = np.zeros((2, skeleton.num_bones))  # sums of the lengths and of their squares
        self._frames = 0

    def update(self, positions: np.ndarray, window_starts: Sequence[int]) -> None:
        """Add a clip.

        Args:
            positions: (T, joints, 3) in metres.
            window_starts: first frame of each window.
        """
        is_seen = np.zeros(len(positions), bool)
        for start in window_starts:
            is_seen[start : start + frames_at(WINDOW_FRAMES, self._fps)] = True
        positions = positions.astype(np.float64)
        directions = positions_to_directions(self._skeleton, positions[is_seen])
        angles = 180 - np.rad2deg(joint_angles(self._skeleton, directions))
        for joint, pair in self._joints.items():
            self._histograms[joint] += np.histogram(angles[:, pair], ANGLE_EDGES)[0]
        is_step = is_seen[1:] & is_seen[:-1]
        speeds = np.linalg.norm(np.diff(positions[:, self._wrists], axis=0), axis=-1)[is_step] * self._fps
        self._speeds += np.histogram(np.minimum(speeds, SPEED_EDGES[-1]), SPEED_EDGES)[0]
        self._speed += speeds.sum()
        parents, children = (list(ends) for ends in zip(*self._skeleton.bones, strict=True))
        lengths = np.linalg.norm(positions[is_seen][:, children] - positions[is_seen][:, parents], axis=-1)
        self._lengths += lengths.sum(axis=0), (lengths**2).sum(axis=0)
        self._frames += len(lengths)

    def result(self) -> dict[str, Any] | None:
        """Return the statistics ready for JSON in metres, metres per second and degrees; None if there is no window."""
        if not self._frames:
            return None
        mean, square = self._lengths / self._frames
        deviation = np.sqrt(np.maximum(square - mean**2, 0))
        published = load_skeleton(self._skeleton.name)
        steps = max(int(self._speeds.sum()), 1)
        return {
            "frames": self._frames,
            "bones": {
                name: {"mean": float(mean[bone]), "std": float(deviation[bone]), "published": float(length)}
                for bone, (name, length) in enumerate(zip(bone_names(published), published.lengths, strict=True))
            },
            "joints": {joint: self._joint(joint, published) for joint in self._joints},
            "angles": _angles(self._skeleton, published),
            "wrist_speed": {
                "mean": float(self._speed / steps),
                "median": _quantile(self._speeds, SPEED_EDGES, 0.5),
                "percentile_95": _quantile(self._speeds, SPEED_EDGES, 0.95),
                "histogram": self._speeds.tolist(),
            },
        }

    def _joint(self, joint: str, published: Skeleton) -> dict[str, Any]:
        pair = self._joints[joint]
        found = {
            name: {
                "mean": 180 * (1 - float(skeleton.angle_mean[pair])),
                "std": 180 * float(np.sqrt(skeleton.angle_variance[pair])),
            }
            for name, skeleton in {"corpus": self._skeleton, "published": published}.items()
        }
        if published.name == "ted_expressive":
            found["table_10"] = dict(zip(("mean", "std"), TABLE_10[joint], strict=True))
        return {**found, "histogram": self._histograms[joint].tolist()}


def inner_angles(skeleton: Skeleton) -> dict[str, int]:
    """Find the angle pair at each shoulder and elbow; the inner angle is 180 degrees minus the angle of the pair.

    Args:
        skeleton: skeleton of the pairs.

    Returns:
        Index in `skeleton.angle_pairs` by name of the joint.
    """
    joints = {}
    for joint in TABLE_10:
        end = skeleton.joint(joint)
        for number, (first, second) in enumerate(skeleton.angle_pairs):
            bones = skeleton.bones
            if max(first, second) < len(bones) and bones[first][1] == end == bones[second][0]:
                joints[joint] = number
    return joints


def bone_names(skeleton: Skeleton) -> list[str]:
    """Return the name "PARENT - CHILD" of each bone."""
    return [f"{skeleton.joints[parent]} - {skeleton.joints[child]}" for parent, child in skeleton.bones]


def _angles(skeleton: Skeleton, published: Skeleton) -> dict[str, dict[str, float]]:
    """Return the angle of every pair of direction vectors in degrees (HA2G, Eq. 8), of the corpus and as published.

    A pair is named by the joints at the ends of its bones.
    """
    names = [*(skeleton.joints[child] for _, child in skeleton.bones), "left palm", "right palm"]
    angles = {}
    for number, (first, second) in enumerate(skeleton.angle_pairs):
        angles[f"{names[first]} - {names[second]}"] = {
            f"{prefix}{name}": 180 * float(value)
            for prefix, of in {"": skeleton, "published_": published}.items()
            for name, value in (
                ("mean", of.angle_mean[number]),
                ("std", np.sqrt(of.angle_variance[number])),
                ("change", of.angle_change[number]),
            )
        }
    return angles


def _quantile(counts: np.ndarray, edges: np.ndarray, fraction: float) -> float:
    """Return the value below which a fraction of a histogram lies, linearly interpolated within its bin."""
    total = np.concatenate([[0], np.cumsum(counts)])
    return float(np.interp(fraction * total[-1], total, edges))
