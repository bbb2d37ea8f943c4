"""Statistics of the motion of a training split, which the model and the physical loss use."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ha2g_jax.data.records import PAPER_FPS, WINDOW_FRAMES, frames_at
from ha2g_jax.skeleton import Skeleton, joint_angles, positions_to_directions


class MotionStatistics:
    """Running means over the frames of all training windows: bone lengths, poses, direction vectors, and angles in
    units of pi (HA2G, Eq. 8).

    Args:
        skeleton: skeleton of the positions.
        fps: frames per second; changes of angles are scaled to those between frames at 15 fps.
    """

    def __init__(self, skeleton: Skeleton, fps: float):
        self._skeleton, self._fps = skeleton, fps
        self._sums: dict[str, np.ndarray] = {}
        self._frames = 0
        self._steps = 0

    def update(self, positions: np.ndarray, window_starts: Sequence[int]) -> None:
        """Add the frames of one clip that lie in a window.

        Args:
            positions: (T, joints, 3) in metres.
            window_starts: first frame of each window.
        """
        is_seen = np.zeros(len(positions), bool)
        for start in window_starts:
            is_seen[start : start + frames_at(WINDOW_FRAMES, self._fps)] = True
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
        }
        is_step = is_seen[1:] & is_seen[:-1]
        changes = {"angle_change": np.abs(np.diff(angles, axis=0))[is_step] * (self._fps / PAPER_FPS)}
        for name, term in ({name: term[is_seen] for name, term in terms.items()} | changes).items():
            self._sums[name] = self._sums.get(name, 0) + term.sum(axis=0)
        self._frames += int(is_seen.sum())
        self._steps += int(is_step.sum())

    def result(self) -> dict[str, Any]:
        """Return the means as nested lists by field name of `Skeleton`, for JSON; empty if there was no window.

        They are rounded to nine decimals, so that the last bits, which differ between processors, do not show.
        """
        if not self._frames:
            return {}
        means = {
            name: total / (max(self._steps, 1) if name == "angle_change" else self._frames)
            for name, total in self._sums.items()
        }
        means["angle_variance"] = np.maximum(means.pop("angle_square") - means["angle_mean"] ** 2, 0)
        return {name: mean.round(9).astype(np.float32).tolist() for name, mean in means.items()}
