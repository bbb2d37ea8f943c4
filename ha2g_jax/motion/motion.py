"""Motion of a skeleton over time, and the `.npz` file that stores it."""

import dataclasses
import json
import pathlib
from typing import Any

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.whole_file import whole_file
from ha2g_jax.skeleton import SKELETONS, Skeleton, directions_to_positions, load_skeleton, normalize

_ARRAYS = ("directions", "positions", "fps", "joint_names", "meta")
_MAX_BYTES = 1 << 31  # of all arrays together; half an hour at 240 frames per second takes a fifth of this


@dataclasses.dataclass(frozen=True)
class Motion:
    """Poses over time in the axes of the TED data: metres, root at the origin, y down; `meta` says where x points.

    Attributes:
        directions: (T, bones, 3) float32 unit direction vectors from parent to child.
        positions: (T, joints, 3) float32 joint positions in metres.
        fps: frames per second; frame k shows the time k / fps.
        joint_names: names of the joints; joint 0 is the root.
        meta: JSON values that say how the motion was made; "skeleton" is the name of the skeleton.
    """

    directions: np.ndarray
    positions: np.ndarray
    fps: float
    joint_names: tuple[str, ...]
    meta: dict[str, Any]

    @classmethod
    def from_directions(
        cls, skeleton: Skeleton, directions: np.ndarray, fps: float, meta: dict[str, Any] | None = None
    ) -> "Motion":
        """Build a motion from direction vectors and the bone lengths of a skeleton.

        Args:
            skeleton: skeleton of the direction vectors.
            directions: (T, bones, 3) direction vectors of any positive length; they are normalised.
            fps: frames per second.
            meta: further entries of `Motion.meta`, as JSON values.

        Returns:
            The motion with T frames.
        """
        directions = normalize(np.asarray(directions, np.float32))
        left, right = (skeleton.mean_pose[skeleton.joint(f"{side}_shoulder"), 0] for side in ("left", "right"))
        axes = {"units": "metres", "x": f"the person's {'left' if left > right else 'right'}", "y": "down"}
        return cls(
            directions=directions,
            positions=directions_to_positions(skeleton, directions),
            fps=float(fps),
            joint_names=skeleton.joints,
            meta={"skeleton": skeleton.name, "axes": axes, **(meta or {})},
        )

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton that `meta` names, with the bone lengths of this motion."""
        skeleton = load_skeleton(self.meta["skeleton"])
        parents, children = (list(ends) for ends in zip(*skeleton.bones, strict=True))
        lengths = np.linalg.norm(self.positions[0, children] - self.positions[0, parents], axis=-1)
        return dataclasses.replace(skeleton, lengths=lengths)

    @property
    def num_frames(self) -> int:
        return len(self.directions)

    def save(self, path: str | pathlib.Path) -> None:
        """Write the motion to an `.npz` file; `formats.export` writes the files of other programs.

        The file is a numpy archive without pickle that holds directions, positions, fps, joint_names and meta (JSON
        text). The same motion gives the same bytes. The file is written completely or not at all.

        Args:
            path: `.npz` file to write.

        Raises:
            UserError: the path does not end in `.npz`, or the file cannot be written.
        """
        path = pathlib.Path(path)
        if path.suffix.lower() != ".npz":
            raise UserError(
                f"Motion.save writes .npz, not {path.name!r}; for other files call "
                f"ha2g_jax.motion.formats.export(motion, {path.name!r})"
            )
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez(
                file,
                directions=self.directions,
                positions=self.positions,
                fps=np.float64(self.fps),
                joint_names=np.array(self.joint_names),
                meta=np.array(json.dumps(self.meta, indent=1, sort_keys=True)),
            )

    @classmethod
    def load(cls, path: str | pathlib.Path) -> "Motion":
        """Read a motion from a file that `save` wrote.

        Args:
            path: `.npz` file to read.

        Returns:
            The motion.

        Raises:
            UserError: the file is missing or does not hold a motion.
        """
        path = pathlib.Path(path)
        if not path.is_file():
            raise UserError(f"no motion at {path}; give an .npz that ha2g generate wrote")
        arrays = read_npz(path, max_bytes=_MAX_BYTES, names=_ARRAYS)
        try:
            motion = cls(
                directions=arrays["directions"],
                positions=arrays["positions"],
                fps=float(arrays["fps"]),
                joint_names=tuple(str(name) for name in arrays["joint_names"]),
                meta=json.loads(str(arrays["meta"])),
            )
            if motion.meta["skeleton"] not in SKELETONS:
                raise ValueError(f"unknown skeleton {motion.meta['skeleton']!r}")  # noqa: TRY301
        except (ValueError, KeyError, TypeError) as error:
            raise UserError(f"{path} is not a motion ({error}); give an .npz that ha2g generate wrote") from error
        return motion
