"""One made-up person who walks and gestures, written in every layout, and readers that share no code with ours."""

import dataclasses
import json
import pathlib
import re

import numpy as np
import pytest

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


def rodrigues(vectors: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of axis-angles (..., 3): I + sin a K + (1 - cos a) K K."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors / np.maximum(angle[..., 0], 1e-12), -1, 0)
    zero = np.zeros_like(x)
    k = np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


@dataclasses.dataclass
class Person:
    """Axis-angles (T, 55, 3) and the place of the pelvis (T, 3), y up."""

    poses: np.ndarray
    trans: np.ndarray

    @property
    def joints(self) -> np.ndarray:
        """Positions (T, 55, 3) by forward kinematics, joint by joint."""
        rest, local = template().points[: len(JOINTS)], rodrigues(self.poses)
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
    from scipy.spatial.transform import Rotation

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
    rest = template().points @ axes.T
    vectors = np.linalg.det(axes) * person.poses @ axes.T  # a reflection turns the axis of a rotation about
    lines, columns = ["HIERARCHY"], []

    def write(joint: int, pad: str) -> None:
        parent = PARENTS[joint]
        offset = 100 * (rest[joint] - (rest[parent] if parent >= 0 else 0))
        angles = Rotation.from_rotvec(vectors[:, joint]).as_euler("ZXY", degrees=True)
        place = [*(100 * person.trans @ axes.T).T] if parent < 0 else []
        columns.extend([*place, *angles.T])
        channels = f"{'6 Xposition Yposition Zposition' if parent < 0 else '3'} Zrotation Xrotation Yrotation"
        lines.extend([f"{pad}{'JOINT' if pad else 'ROOT'} {name(JOINTS[joint])}", pad + "{"])
        lines.extend([f"{pad} OFFSET {' '.join(map(str, offset))}", f"{pad} CHANNELS {channels}"])
        children = [c for c, p in enumerate(PARENTS) if p == joint and JOINTS[c] not in ("jaw", *EYES)]
        for child in children:
            write(child, pad + " ")
        if not children:
            lines.extend([f"{pad} End Site", pad + " {", f"{pad}  OFFSET 0 1 0", pad + " }"])
        lines.append(pad + "}")

    write(0, "")
    rows = np.stack(columns, axis=-1)
    lines += ["MOTION", f"Frames: {len(rows)}", f"Frame Time: {1 / FPS:.8f}"]
    return "\n".join([*lines, *(" ".join(f"{value:.6f}" for value in row) for row in rows)]) + "\n"


EYES = ("left_eyeball", "right_eyeball")


def read_bvh_positions(path: pathlib.Path) -> dict[str, np.ndarray]:
    """Positions (T, 3) of each joint of a BVH, by its definition: M_child = M_parent T(offset) R R R."""
    head, motion = path.read_text().split("MOTION")
    rows = np.array([line.split() for line in motion.strip().splitlines()[2:]], float)
    stack, joints, column = [], {}, 0
    for line in head.splitlines():
        words = line.split()
        if words[:1] in (["ROOT"], ["JOINT"]):
            stack.append({"name": words[1], "parent": stack[-1] if stack else None})
        elif words[:1] == ["End"]:
            stack.append({"name": None})
        elif words[:1] == ["OFFSET"]:
            stack[-1]["offset"] = np.array(words[1:], float)
        elif words[:1] == ["CHANNELS"]:
            joint, channels = stack[-1], words[2:]
            values = dict(zip(channels, rows[:, column : column + len(channels)].T, strict=True))
            column += len(channels)
            turn = np.tile(np.eye(3), (len(rows), 1, 1))
            for channel in channels:
                if channel.endswith("rotation"):
                    axis = np.eye(3)["XYZ".index(channel[0])]
                    turn = turn @ rodrigues(np.deg2rad(values[channel])[:, None] * axis)
            place = np.tile(joint["offset"], (len(rows), 1))
            if "Xposition" in values:
                place = np.stack([values[f"{axis}position"] for axis in "XYZ"], axis=-1)
            above = joint["parent"]
            joint["turn"] = turn if above is None else above["turn"] @ turn
            joint["place"] = place if above is None else (
                above["place"] + (above["turn"] @ place[:, :, None])[:, :, 0]
            )  # fmt: skip
            joints[joint["name"]] = joint["place"]
        elif words[:1] == ["}"]:
            stack.pop()
    return joints


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
    from scipy.spatial.transform import Rotation

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
    named = {"fps": FPS, "joint_names": list(motion.joint_names), "positions": motion.positions.tolist()}
    paths["named positions npz"] = folder / "named.npz"
    np.savez(paths["named positions npz"], **named)
    paths["named positions"] = folder / "named.json"
    paths["named positions"].write_text(json.dumps(named))
    return paths
