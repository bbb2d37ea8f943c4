"""Statistics of the motion of a training split, as the model and the physical loss use them."""

from typing import Any

import numpy as np

from ha2g_jax.skeleton import Skeleton, joint_angles, positions_to_directions


class MotionStatistics:
    """Running means over clips: bone lengths, poses, direction vectors, and angles in units of pi (HA2G, Eq. 8)."""

    def __init__(self, skeleton: Skeleton):
        self._skeleton = skeleton
        self._sums: dict[str, np.ndarray] = {}
        self._frames = 0
        self._steps = 0

    def update(self, positions: np.ndarray) -> None:
        """Adds one clip, (T, joints, 3) positions in metres."""
        positions = positions.astype(np.float64)
        directions = positions_to_directions(self._skeleton, positions)
        parents, children = (list(ends) for ends in zip(*self._skeleton.bones, strict=True))
        angles = joint_angles(self._skeleton, directions) / np.pi
        terms = {
            "lengths": np.linalg.norm(positions[:, children] - positions[:, parents], axis=-1),
            "mean_pose": positions - positions[:, :1],
            "mean_directions": directions,
            "angle_mean": angles,
            "angle_square": angles**2,
            "angle_change": np.abs(np.diff(angles, axis=0)),
        }
        for name, term in terms.items():
            self._sums[name] = self._sums.get(name, 0) + term.sum(axis=0)
        self._frames += len(positions)
        self._steps += len(positions) - 1

    def result(self) -> dict[str, Any]:
        """Nested lists, ready for JSON, under the field names of `Skeleton`."""
        means = {
            name: total / (self._steps if name == "angle_change" else self._frames)
            for name, total in self._sums.items()
        }
        means["angle_variance"] = np.maximum(means.pop("angle_square") - means["angle_mean"] ** 2, 0)
        return {name: mean.astype(np.float32).tolist() for name, mean in means.items()}
