"""Motion of a skeleton over time, and the `.npz` file that stores it."""

import dataclasses
import json
import os
import pathlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from ha2g_jax import limits
from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import parse_json, reading, reason, shown
from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion import lower_body
from ha2g_jax.motion.lower_body import LowerBody
from ha2g_jax.skeleton import (
    SKELETONS,
    Skeleton,
    bone_lengths,
    directions_to_positions,
    load_skeleton,
    normalize,
    positions_to_directions,
)

FACE = {"expressions": None, "jaw": 3, "arkit": 52}  # number of values, None for any
"""Names of the arrays of `Motion.face`; in a file with "face_" before them."""

ARRAYS = ("directions", "positions", "fps", "joint_names", "meta", *lower_body.ARRAYS, *(f"face_{it}" for it in FACE))

_SAMPLED = 500  # frames whose bone lengths are averaged
_MIN_LENGTH, _MAX_LENGTH = 1e-3, 1e3  # of a direction vector, which should have length 1
_MAX_METRES = 100.0
_MIN_BONE = 1e-3  # metres between the two joints of a bone
_BLOCK = 10_000  # frames that are checked together, so that a long motion needs no second copy


@dataclasses.dataclass(frozen=True)
class Motion:
    """Poses over time in the axes of the TED data: metres, root at the origin, y down; `meta` says where x points.

    Attributes:
        directions: (T, bones, 3) float32 unit direction vectors from parent to child.
        positions: (T, joints, 3) float32 joint positions in metres.
        fps: frames per second; frame k shows the time k / fps.
        joint_names: names of the joints; joint 0 is the root.
        meta: JSON values that say how the motion was made; "skeleton" is the name of the skeleton.
        lower: pelvis, legs and position of the person, if known; nothing is generated for them.
        face: values (T, n) by name, which exports pass on unchanged: "expressions" of FLAME, "jaw", (T, 3) axis-angle
            vectors, and "arkit", (T, 52) weights.
    """

    directions: np.ndarray
    positions: np.ndarray
    fps: float
    joint_names: tuple[str, ...]
    meta: dict[str, Any]
    lower: LowerBody | None = None
    face: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def __repr__(self) -> str:
        parts = [name for name, value in (("lower body", self.lower), ("face", self.face)) if value]
        facts = [f"{self.num_frames} frames", f"{self.fps:g} fps", f"{self.num_frames / self.fps:.2f} s"]
        return f"Motion({', '.join([*facts, str(self.meta.get('skeleton')), *parts])})"

    @classmethod
    def from_directions(
        cls, skeleton: Skeleton, directions: np.ndarray, fps: float, meta: dict[str, Any] | None = None
    ) -> "Motion":
        """Build a motion from directions (T, bones, 3), which are normalised, and a skeleton's bone lengths.

        The values of `meta`, including numbers and arrays of NumPy, are converted to those of JSON.

        Raises:
            TypeError: `meta` has a value that JSON does not know.
        """
        directions = normalize(np.asarray(directions, np.float32))
        axes = {"units": "metres", "x": f"the person's {'left' if skeleton.left > 0 else 'right'}", "y": "down"}
        plain = json.loads(json.dumps(meta or {}, default=_plain))
        return cls(
            directions=directions,
            positions=directions_to_positions(skeleton, directions),
            fps=float(fps),
            joint_names=skeleton.joints,
            meta={"skeleton": skeleton.name, "axes": axes, **plain},
        )

    @classmethod
    def from_positions(
        cls,
        skeleton: Skeleton,
        positions: np.ndarray,
        fps: float,
        meta: dict[str, Any] | None = None,
        *,
        lower: LowerBody | None = None,
        face: dict[str, np.ndarray] | None = None,
    ) -> "Motion":
        """Build a motion from positions (T, joints, 3) in metres, which it keeps, relative to each frame's root."""
        directions = positions_to_directions(skeleton, np.asarray(positions, np.float64))
        motion = cls.from_directions(skeleton, directions, fps, meta)
        places = (positions - positions[:, :1]).astype(np.float32)
        return dataclasses.replace(motion, positions=places, lower=lower, face=face or {})

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton that `meta` names, with the mean bone lengths of this motion."""
        skeleton = load_skeleton(self.meta["skeleton"])
        # A person's neck and shoulders have joints between them, so that some lengths vary; samples suffice.
        sample = self.positions[:: max(1, self.num_frames // _SAMPLED)]
        lengths = bone_lengths(skeleton, sample).mean(axis=0)
        return dataclasses.replace(skeleton, lengths=lengths)

    @property
    def num_frames(self) -> int:
        return len(self.directions)

    def check(self) -> None:
        """Check the motion before it is converted, drawn, exported or continued.

        Raises:
            UserError: the skeleton or the joints are unknown, the arrays do not fit together, there are no or too many
                frames, the frame rate is out of range, a value is not finite, a direction vector has no usual length,
                a bone has no length, or a position is too far away.
        """
        _check_skeleton(self)
        if self.lower is not None:
            self.lower.check(self.num_frames)
        _check_face(self.face, self.num_frames)

    def save(self, path: str | pathlib.Path) -> None:
        """Write the motion to an `.npz` file; `formats.export` writes the files of other programs.

        The file is a numpy archive without pickle that holds directions, positions, fps, joint_names, meta (JSON text),
        and where they are known the arrays of `lower_body.ARRAYS` and of the face. The same motion gives the same
        bytes. The file is written atomically.

        Raises:
            UserError: the path does not end in `.npz`, or the file cannot be written.
            ValueError: `meta` has a number that is not finite, which JSON cannot hold.
        """
        path = pathlib.Path(path)
        if path.suffix.lower() != ".npz":
            raise UserError(
                f"Motion.save writes .npz, not {path.name!r}; for other files call "
                f"ha2g_jax.motion.formats.export(motion, {path.name!r})"
            )
        more: dict[str, Any] = {f"face_{name}": values for name, values in self.face.items()}
        if self.lower is not None:
            more |= self.lower.as_arrays()
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez(
                file,
                directions=self.directions,
                positions=self.positions,
                fps=np.float64(self.fps),
                joint_names=np.array(self.joint_names),
                meta=np.array(json.dumps(self.meta, indent=1, sort_keys=True, allow_nan=False)),
                **more,
            )

    @classmethod
    def load(cls, path: str | pathlib.Path) -> "Motion":
        """Read a motion from an `.npz` file that `save` wrote.

        Raises:
            UserError: the file is missing or does not hold a motion.
        """
        path = pathlib.Path(path)
        with reading(path, "a motion of ha2g generate"):
            if not path.is_file():
                raise UserError(f"no motion at {shown(path)}; give an .npz of ha2g generate or ha2g export")
            with path.open("rb") as file:
                is_zip = file.read(2) == b"PK"
        if not is_zip and path.suffix.lower() != ".npz":
            raise UserError(
                f"{shown(path)} is not an .npz; make one of a motion in another format: ha2g export {shown(path)} "
                "--out MOTION.npz"
            )
        return cls.from_arrays(read_npz(path, max_bytes=limits.MAX_MOTION_BYTES, names=ARRAYS), path)

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], path: str | os.PathLike) -> "Motion":
        """Build a motion from the arrays of a file that `save` wrote, `ARRAYS` by name, and check it.

        Raises:
            UserError: the arrays do not hold a motion; the message names the path.
        """
        try:
            motion = cls(
                directions=arrays["directions"],
                positions=arrays["positions"],
                fps=float(arrays["fps"].reshape(())),
                joint_names=_parse_names(arrays["joint_names"]),
                meta=_parse_meta(arrays["meta"]),
                lower=LowerBody.from_arrays(arrays),
                face={name: arrays[f"face_{name}"] for name in FACE if f"face_{name}" in arrays},
            )
            motion.check()
        except UserError as error:
            raise UserError(f"{shown(path)}: {error}") from error
        except (ValueError, KeyError, TypeError) as error:
            why = f"it has no {error}" if isinstance(error, KeyError) else reason(error)
            raise UserError(
                f"{shown(path)} is not a motion ({why}); give an .npz of ha2g generate or ha2g export"
            ) from error
        return motion


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):  # an array or a number, of NumPy or JAX
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no value of JSON")


def _parse_names(names: np.ndarray) -> tuple[str, ...]:
    if names.size > limits.MAX_MOTION_JOINTS or names.nbytes > limits.MAX_MOTION_META_BYTES:
        raise ValueError(f"joint_names of shape {names.shape} and {names.nbytes} bytes")
    return tuple(str(name) for name in names)


def _parse_meta(text: np.ndarray) -> dict[str, Any]:
    if text.nbytes > 4 * limits.MAX_MOTION_META_BYTES:  # four bytes a letter
        raise ValueError(f"meta of {text.nbytes // 4} bytes, more than the {limits.MAX_MOTION_META_BYTES} allowed")
    meta = parse_json(str(text.reshape(())))
    if not isinstance(meta, dict):
        raise TypeError(f"meta is a {type(meta).__name__}, not an object")
    json.dumps(meta, allow_nan=False)
    return meta


def check_length(frames: int, fps: float) -> None:
    """Check the number of frames of a motion, their rate, and the length in seconds that follows.

    Raises:
        UserError: one of the three is out of range.
    """
    if not 1 <= frames <= limits.MAX_MOTION_FRAMES:
        raise UserError(
            f"the motion has {frames} frames; expected 1 to {limits.MAX_MOTION_FRAMES}: cut it, or generate at a lower "
            "frame rate"
        )
    if not limits.MIN_MOTION_FPS <= fps <= limits.MAX_MOTION_FPS:
        raise UserError(
            f"the motion has {fps} frames per second; expected {limits.MIN_MOTION_FPS} to {limits.MAX_MOTION_FPS}: "
            "give its true rate"
        )
    if frames > limits.MAX_MOTION_SECONDS * fps:
        raise UserError(
            f"the motion has {frames / fps:.0f} seconds, {frames} frames at {fps:g} a second; expected at most "
            f"{limits.MAX_MOTION_SECONDS}: cut it"
        )


def _check_skeleton(motion: Motion) -> None:
    name = motion.meta.get("skeleton")
    if name not in SKELETONS:
        raise UserError(f"the motion has skeleton {str(name)[:40]!r}; expected {' or '.join(SKELETONS)}")
    skeleton = load_skeleton(name)
    if motion.joint_names != skeleton.joints:
        pairs = zip(motion.joint_names, skeleton.joints, strict=False)
        first = next((f"{str(found)[:40]!r} for {ours}" for found, ours in pairs if found != ours), "another number")
        raise UserError(
            f"the motion has {len(motion.joint_names)} joints, not the {skeleton.num_joints} of {name} ({first}); "
            "give one that ha2g generate wrote"
        )
    frames = motion.directions.shape[0] if motion.directions.ndim else 0
    for kind, array, count in (
        ("directions", motion.directions, skeleton.num_bones),
        ("positions", motion.positions, skeleton.num_joints),
    ):
        if array.shape != (frames, count, 3) or array.dtype.kind != "f":
            raise UserError(
                f"the motion's {kind} are {array.dtype} of shape {array.shape}; expected floats, {(frames, count, 3)}"
            )
    check_length(frames, motion.fps)
    _check_values(motion.directions, motion.positions, skeleton)


def _check_values(directions: np.ndarray, positions: np.ndarray, skeleton: Skeleton) -> None:
    ends = [skeleton.joints[child] for _, child in skeleton.bones]
    for start in range(0, len(directions), _BLOCK):
        vectors, places = directions[start : start + _BLOCK], positions[start : start + _BLOCK]
        for kind, array, names in (
            ("direction of the bone to", vectors, ends),
            ("position of", places, skeleton.joints),
        ):
            is_bad = ~np.isfinite(array).all(axis=-1)
            if is_bad.any():
                frame, index = np.argwhere(is_bad)[0]
                raise UserError(
                    f"the {kind} {names[index]} in frame {start + frame} is not a number; expected finite values: "
                    "generate the motion again"
                )
        if (largest := float(np.abs(places).max())) > _MAX_METRES:
            raise UserError(f"a joint of the motion is {largest:.4g} m away; expected metres, within {_MAX_METRES:g}")
        # The largest component of a vector, because the square of a wrong number may be infinite.
        lengths = np.abs(vectors).max(axis=-1)
        is_odd = (lengths < _MIN_LENGTH) | (lengths > _MAX_LENGTH)
        if is_odd.any():
            frame, bone = np.argwhere(is_odd)[0]
            raise UserError(
                f"the bone to {ends[bone]} in frame {start + frame} has a direction of length "
                f"{lengths[frame, bone]:.4g}; expected unit vectors: generate the motion again"
            )
    bones = bone_lengths(skeleton, positions[0].astype(np.float64))
    if (bones < _MIN_BONE).any():
        bone = int(np.argmin(bones))
        raise UserError(
            f"the bone to {ends[bone]} is {bones[bone]:.4g} m long; expected at least {_MIN_BONE}: generate the motion "
            "again"
        )


def _check_face(face: Mapping[str, np.ndarray], frames: int) -> None:
    for name, values in face.items():
        if (
            values.ndim != 2
            or len(values) != frames
            or values.dtype.kind != "f"
            or values.shape[1] > limits.MAX_FACE_VALUES
            or values.shape[1] != (FACE[name] or values.shape[1])
        ):
            raise UserError(
                f"the motion's face_{name} are {values.dtype} of shape {values.shape}; expected floats, "
                f"({frames}, {FACE[name] or f'at most {limits.MAX_FACE_VALUES}'})"
            )
        if not (np.abs(values) <= _MAX_LENGTH).all():
            raise UserError(f"the motion's face_{name} have values that are not finite or too large; export it again")
