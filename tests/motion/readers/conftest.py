"""One made-up person who walks and gestures, written in every layout, and readers that share no code with ours."""

import dataclasses
import json
import pathlib
import re

import numpy as np
import pytest
from motion.readers import bvh_files
from scipy.spatial.transform import Rotation

from ha2g_jax.motion.readers.smplx_body import JOINTS, PARENTS, template

FPS, FRAMES = 30, 60
MIXAMO = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head",
    "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase",
    "collar": "Shoulder", "shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand",
}  # fmt: skip
GENEA = {
    "pelvis": "b_root", "spine1": "b_spine0", "spine2": "b_spine2", "spine3": "b_spine3", "neck": "b_neck0",
    "head": "b_head", "hip": "upleg", "knee": "leg", "ankle": "foot", "foot": "ball",
    "collar": "shoulder", "shoulder": "arm", "elbow": "forearm", "wrist": "wrist",
}  # fmt: skip
ZEROEGGS = MIXAMO | {"spine3": "Spine3", "spine2": "Spine2"}
BEAT = ZEROEGGS | {"shoulder": "{side}Arm", "elbow": "{side}Arm1", "wrist": "{side}Hand"}


def named(side: str, name: str) -> str:
    """The name of a joint of a side: LArm for {side}Arm, and LeftFoot for Foot."""
    return name.format(side=side[0].upper()) if "{" in name else f"{side.title()}{name}"


@dataclasses.dataclass
class Person:
    """Axis-angles (T, 55, 3) and the place of the pelvis (T, 3), y up."""

    poses: np.ndarray
    trans: np.ndarray

    @property
    def joints(self) -> np.ndarray:
        """Positions (T, 55, 3) by forward kinematics, joint by joint."""
        rest = template().points[: len(JOINTS)]
        local = Rotation.from_rotvec(self.poses.reshape(-1, 3)).as_matrix().reshape(-1, len(JOINTS), 3, 3)
        places, turned = np.empty((len(local), len(JOINTS), 3)), np.empty_like(local)
        for joint, parent in enumerate(PARENTS):
            turned[:, joint] = local[:, joint] if parent < 0 else turned[:, parent] @ local[:, joint]
            places[:, joint] = self.trans + rest[0] if parent < 0 else (
                places[:, parent] + turned[:, parent] @ (rest[joint] - rest[parent])
            )  # fmt: skip
        return places

    def at(self, name: str) -> np.ndarray:
        """Positions (T, 3) of a joint by its name in SMPL-X."""
        return self.joints[:, JOINTS.index(name)]


@pytest.fixture(scope="session")
def person() -> Person:
    times = np.arange(FRAMES) / FPS
    rng = np.random.default_rng(3)
    poses = 0.15 * np.sin(2 * np.pi * (rng.uniform(0.3, 1.2, (55, 3)) * times[:, None, None] + rng.random((55, 3))))
    index = {name: place for place, name in enumerate(JOINTS)}
    for side, sign in (("left", 1), ("right", -1)):
        poses[:, index[f"{side}_shoulder"], 2] -= sign * 1.0  # arms hang
        poses[:, index[f"{side}_elbow"], 1] -= sign * 0.8  # elbows are bent
        poses[:, index[f"{side}_knee"], 0] += 0.4
        for name in JOINTS:
            if name.startswith(side) and name[-1] in "23" and "thumb" not in name:
                poses[:, index[name], 2] -= sign * 0.5  # fingers curl to the palm
    poses[:, index["pelvis"]] *= 0.5
    trans = np.stack([0.2 * np.sin(times), 0.95 + 0.02 * np.sin(3 * times), 0.3 * times], axis=-1)
    return Person(poses, trans)


def bvh(person: Person, names: dict[str, str] | None, axes: np.ndarray | None = None) -> str:
    """The person as BVH in centimetres, in the names of another program.

    Args:
        person: person with y up, facing +z.
        names: names of the joints; None for those of `ha2g export`.
        axes: (3, 3) axes of the file as rows, left-handed ones with the determinant -1; the same by default.
    """

    def name(joint: str) -> str:
        if names is None:
            return {"spine3": "spine"}.get(joint, joint)
        side, _, part = joint.partition("_")
        if side not in ("left", "right"):
            return names[joint]
        finger = re.fullmatch(r"(\w+)_(\d)", part)
        if names is GENEA:
            return f"b_{side[0]}_{finger[1]}{finger[2]}" if finger else f"b_{side[0]}_{names[part]}"
        if names is BEAT:
            return f"{side[0].upper()}Hand{finger[1][0].upper()}{finger[2]}" if finger else named(side, names[part])
        return f"{side.title()}Hand{finger[1].title()}{finger[2]}" if finger else f"{side.title()}{names[part]}"

    axes = np.eye(3) if axes is None else axes
    kept = [joint for joint, name in enumerate(JOINTS) if name not in ("jaw", "left_eyeball", "right_eyeball")]
    rest = 100 * template().points[: len(JOINTS)] @ axes.T
    offsets = np.array([rest[joint] - (rest[PARENTS[joint]] if joint else 0) for joint in kept])
    vectors = np.linalg.det(axes) * person.poses[:, kept] @ axes.T  # a reflection turns the axis of a rotation about
    angles = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_euler("ZXY", degrees=True).reshape(vectors.shape)
    parents = [kept.index(PARENTS[joint]) if joint else -1 for joint in kept]
    joint_names = [name(JOINTS[joint]) for joint in kept]
    return bvh_files.write(joint_names, parents, offsets, angles, 100 * person.trans @ axes.T, order="ZXY", fps=FPS)


@pytest.fixture(scope="session")
def files(person, tmp_path_factory) -> dict[str, pathlib.Path]:
    """The person in each layout, by the name of the layout."""
    folder = tmp_path_factory.mktemp("files")
    flat = person.poses.reshape(FRAMES, -1)
    rate, face = {"mocap_frame_rate": FPS}, np.linspace(0, 1, FRAMES * 100).reshape(FRAMES, 100)
    arkit = np.linspace(0, 1, FRAMES * 52).reshape(FRAMES, 52)
    beat2 = {
        "poses": flat,
        "trans": person.trans,
        "betas": np.zeros(300),
        "expressions": face,
        "arkit": arkit,
        "gender": "neutral",
    }
    # AMASS has z up: the root and the place are rotated.
    to_z = Rotation.from_euler("x", 90, degrees=True)
    root = (to_z * Rotation.from_rotvec(person.poses[:, 0])).as_rotvec()
    z_up, place = np.concatenate([root, flat[:, 3:]], axis=1), to_z.apply(person.trans)
    parts = {"root_orient": root, "pose_body": flat[:, 3:66], "pose_hand": flat[:, 75:], "pose_jaw": flat[:, 66:69]}
    smplh = {"poses": np.concatenate([z_up[:, :66], z_up[:, 75:]], axis=1), "trans": place, "dmpls": np.zeros((9, 8))}
    package = {"global_orient": flat[:, :3], "body_pose": flat[:, 3:66], "jaw_pose": flat[:, 66:69]}
    package |= {"left_hand_pose": flat[:, 75:120], "right_hand_pose": flat[:, 120:], "expression": face[:, :10]}
    made = {
        "BEAT2": ("beat2.npz", beat2 | rate),
        "AMASS SMPL-X": ("amass.npz", {"poses": z_up, "trans": place, "surface_model_type": "smplx"} | rate),
        "AMASS SMPL-H": ("smplh.npz", smplh | {"mocap_framerate": float(FPS), "betas": np.zeros(16)}),
        "AMASS parts": ("parts.npz", parts | {"trans": place} | rate),
        "smplx package": ("package.npz", package | {"transl": person.trans, "fps": FPS}),
        "SMPL-X joints": ("joints.npz", {"joints": person.joints, "fps": FPS}),
    }
    paths = {}
    for kind, (name, arrays) in made.items():
        np.savez(folder / name, **arrays)
        paths[kind] = folder / name
    for kind, names in (("BVH", MIXAMO), ("GENEA BVH", GENEA), ("BEAT BVH", BEAT), ("ZeroEGGS BVH", ZEROEGGS)):
        paths[kind] = folder / f"{kind.split()[0].lower()}.bvh"
        paths[kind].write_text(bvh(person, names))
    from ha2g_jax.motion import formats
    from ha2g_jax.motion.readers import read_motion

    motion = read_motion(paths["BEAT2"])
    directions, mean = motion.directions, motion.skeleton.mean_directions
    gesture = read_motion(paths["BEAT2"], skeleton="ted_gesture")
    for kind, array in {
        "directions": directions.reshape(FRAMES, 126),
        "directions less mean": directions - mean,
        "TED-Gesture directions": gesture.directions.reshape(FRAMES, 27),
        "TED-Expressive positions": motion.positions,
        "TED-Gesture positions": gesture.positions,
        "SMPL-X joints array": person.joints,
    }.items():
        paths[kind] = folder / f"{kind.replace(' ', '_')}.npy"
        np.save(paths[kind], array)
    motion.save(folder / "own.npz")
    paths["own"] = folder / "own.npz"
    for kind, name in (("glTF", "moved.glb"), ("VRM animation", "moved.vrma"), ("table", "moved.csv")):
        paths[kind] = folder / name
        formats.export(motion, paths[kind])
    named = {"fps": FPS, "joint_names": list(motion.joint_names), "positions": motion.positions.tolist()}
    paths["named positions npz"] = folder / "named.npz"
    np.savez(paths["named positions npz"], **named)
    paths["named positions"] = folder / "named.json"
    paths["named positions"].write_text(json.dumps(named))
    return paths
