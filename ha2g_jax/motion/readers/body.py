"""The body of captured motion, for any kind of file: axes, left and right, face and legs."""

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.errors import UserError
from ha2g_jax.limits import MAX_MOTION_FPS, MAX_POSED_JOINTS, MAX_SOUND_SECONDS, MIN_MOTION_FPS
from ha2g_jax.motion.armature import FOUR_FINGERS, LEFT, ha2g_armature, rest_positions
from ha2g_jax.motion.lower_body import JOINTS, PARENTS, LowerBody
from ha2g_jax.motion.rotations import unit
from ha2g_jax.skeleton import Skeleton

UPS = ("y", "-y", "z", "-z", "x", "-x")
ARM, ARM_RANGE = 0.55, (0.3, 1.0)  # metres from shoulder to wrist of an adult, and of any person
MAX_MINUTES = 2 * MAX_SOUND_SECONDS / 60  # length of a motion: audio must have at least half the length of its motion

_AXES_UP = np.array([(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0)], float)
_UP_VECTORS = dict(zip(UPS, _AXES_UP, strict=True))
# Minimum horizontal fraction of the shoulders' width, in a frame and on average, that determines where a person faces.
_MIN_LEVEL, _MIN_MEAN_LEVEL = 0.2, 0.1
_MIN_EVIDENCE = 0.15  # mean evidence of feet and hands, each from -1 to 1, that suffices for a verdict

FACE = ("nose", "head", "right_eye", "left_eye", "right_ear", "left_ear")

# Direction of the foot in the T-pose, from the ankle to its ball; a file without toes has feet of this length.
_FOOT = np.array([0.0, -0.36, 0.93])
MIN_BONE = 1e-4
"""Metres between the two joints of a bone of a leg, below which it has no direction."""
_FOOT_LENGTH = 0.14
_KEEPS = 0.9  # cosine with its axis of a trunk that keeps to it; nobody leans as far for a whole recording
_DOWN = np.array([0.0, -1.0, 0.0])


def arm_length(positions: np.ndarray, skeleton: Skeleton, *sides: str) -> float:
    """Return the median length of the arms from shoulder to wrist, in the unit of positions (T, joints, 3)."""
    arms = [[skeleton.joint(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist")] for side in sides]
    bones = np.linalg.norm(np.diff(positions[:, arms], axis=2), axis=-1)
    return float(np.median(bones.sum(axis=-1)))


def check_arms(length: float, metres: float) -> None:
    """Raise a UserError if arms of a length in units of so many metres are not those of a person."""
    if not ARM_RANGE[0] <= length * metres <= ARM_RANGE[1]:
        raise UserError(
            f"it has arms {length:.4g} units long from shoulder to wrist, {length * metres:.4g} m for a unit of "
            f"{metres:g} m; expected about {ARM} m: give the metres in one unit (--unit)"
        )


def check_stated(source_fps: float | None, unit: float | None) -> None:
    """Raise a UserError if the frames per second or the metres in one unit that a user states are out of range."""
    if source_fps is not None and not MIN_MOTION_FPS <= source_fps <= MAX_MOTION_FPS:
        raise UserError(f"{source_fps:g} frames per second of the file; expected {MIN_MOTION_FPS} to {MAX_MOTION_FPS}")
    if unit is not None and not 0 < unit < np.inf:
        raise UserError(f"a unit of {unit:g} m; expected metres, such as 0.01 for centimetres")


def check_size(num_joints: int, num_frames: int) -> None:
    """Raise a UserError if the joints in all frames together are more than `MAX_POSED_JOINTS`."""
    if num_joints * num_frames > MAX_POSED_JOINTS:
        raise UserError(
            f"{num_joints} joints in {num_frames} frames, {num_joints * num_frames:,} together; expected at most "
            f"{MAX_POSED_JOINTS:,}: cut the file"
        )


def to_skeleton_axes(
    positions: np.ndarray, skeleton: Skeleton, *, up: str = "y", axes: np.ndarray | None = None
) -> np.ndarray:
    """Rotate and translate a recording (T, joints, 3), in metres, as one rigid body into the axes of a skeleton.

    The rotation maps the up axis and the mean heading onto those of the skeleton (TED-Expressive: left +x, ahead -z;
    TED-Gesture: left -x, ahead +z), so the vertical stays vertical. The translation maps the mean position of the spine
    onto that of the mean pose. The axes (3, 3) are those of `mean_heading` unless others are given.

    Raises:
        UserError: the shoulders lie along the up axis, so that there is no heading.
    """
    axes = mean_heading(positions, skeleton, up=up) if axes is None else axes
    rotated = np.asarray(positions, np.float64) @ axes
    return rotated + (skeleton.mean_pose[0] - rotated[:, 0].mean(axis=0))


def mean_heading(positions: np.ndarray, skeleton: Skeleton, *, up: str = "y") -> np.ndarray:
    """Return the axes of the skeleton in the coordinates of the file, for the whole recording.

    Args:
        positions: (T, joints, 3) in any unit.
        up: axis of the file that points up, one of `UPS`.

    Returns:
        (3, 3) rotation matrix whose columns are x, y and z of the skeleton.

    Raises:
        UserError: the shoulders lie along the up axis.
    """
    left, level = _left(positions, skeleton, up)
    if level.max(initial=0) < _MIN_LEVEL:
        raise UserError(
            f"the person's shoulders lie along the {up} axis, which was taken to point up; name another axis as up"
        )
    mean = left.mean(axis=0)
    if np.linalg.norm(mean) < _MIN_MEAN_LEVEL:  # a person who faces all directions: the first heading counts
        mean = left[np.argmax(level >= _MIN_LEVEL)]
    return _frame(mean[None], skeleton, up)[0]


def _headings(positions: np.ndarray, skeleton: Skeleton, up: str) -> tuple[np.ndarray, np.ndarray]:
    """Find the axes of `mean_heading` frame by frame; they follow the shoulders, and y is always vertical.

    Returns:
        (T, 3, 3) rotation matrices, and (T,) reliability of each, from 0 (the shoulders are vertical) to 1.
    """
    left, level = _left(positions, skeleton, up)
    is_level = level >= _MIN_LEVEL
    left[~is_level] = np.roll(_UP_VECTORS[up], 1)  # any horizontal vector
    return _frame(left, skeleton, up), np.where(is_level, level, 0.0)


def choose_up(positions: np.ndarray, skeleton: Skeleton, stated: str | None) -> str:
    """Return the axis that is stated to point up, or else the one nearest to the mean direction from spine to neck.

    Raises:
        UserError: the trunk keeps to another axis than the stated one.
    """
    trunk = _trunk(positions, skeleton)
    found = max(UPS, key=lambda up: float(trunk @ _UP_VECTORS[up]))
    if stated not in (None, found) and trunk @ _UP_VECTORS[found] > _KEEPS:
        raise UserError(f"up is stated as {stated}, but the trunk points along {found}; correct it, or leave it out")
    return stated or found


def is_turned(positions: np.ndarray, skeleton: Skeleton, up: str) -> bool:
    """Return whether the trunk keeps to another axis than y, as where another program turned the root of a file."""
    return up != "y" and float(_trunk(positions, skeleton) @ _UP_VECTORS[up]) > _KEEPS


def _trunk(positions: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Return the mean of the unit vectors (3,) from spine to neck."""
    return unit(positions[:, skeleton.joint("neck")] - positions[:, skeleton.joint("spine")]).mean(axis=0)


def _left(positions: np.ndarray, skeleton: Skeleton, up: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the horizontal part of each frame's unit vector to the person's left, (T, 3), and its length (T,)."""
    shoulders = positions[:, skeleton.joint("left_shoulder")] - positions[:, skeleton.joint("right_shoulder")]
    vertical, left = _UP_VECTORS[up], unit(shoulders)
    left = left - (left @ vertical)[:, None] * vertical
    return left, np.linalg.norm(left, axis=-1)


def _frame(left: np.ndarray, skeleton: Skeleton, up: str) -> np.ndarray:
    """Return (T, 3, 3) with the skeleton's axes as columns, from horizontal vectors (T, 3) to the person's left."""
    left = left / np.linalg.norm(left, axis=-1, keepdims=True)
    x = skeleton.left * left
    y = np.broadcast_to(-_UP_VECTORS[up], x.shape)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def is_mirrored(positions: np.ndarray, skeleton: Skeleton, feet: np.ndarray | None = None) -> bool:
    """Return whether a motion (T, joints, 3) is clearly the mirror image of a person's, as in left-handed axes.

    A mirror image has the bones and the speeds of the motion, but no human body: where left and up point to the
    person's back, toes and knees point backwards, and fingers bend towards the back of the hand. The feet, if known,
    are (T, 4, 3): left ankle, left ball of the foot, right ankle and right ball.
    """
    signs = [_bend(positions, skeleton, side) for side in ("left", "right") if "left_index_1" in skeleton.joints]
    if feet is not None:
        signs += [_toes(positions, skeleton, feet)] * 2  # feet are seen more clearly than hands
    return bool(signs) and float(np.mean(signs)) < -_MIN_EVIDENCE


def _toes(positions: np.ndarray, skeleton: Skeleton, feet: np.ndarray) -> float:
    """Return the mean cosine between the feet and the front of the person, both level."""
    spine, neck, left, right = (
        positions[:, skeleton.joint(name)] for name in ("spine", "neck", "left_shoulder", "right_shoulder")
    )
    up = unit((neck - spine).mean(axis=0))
    ahead = np.cross(left - right, up)
    toes = (feet[:, 1] - feet[:, 0]) + (feet[:, 3] - feet[:, 2])
    toes = toes - (toes @ up)[:, None] * up
    lengths = np.linalg.norm(toes, axis=-1) * np.linalg.norm(ahead, axis=-1)
    return float(np.mean(np.sum(toes * ahead, axis=-1) / np.maximum(lengths, 1e-12)))


def _bend(positions: np.ndarray, skeleton: Skeleton, side: str) -> float:
    """Return how far the fingers of a hand bend to the palm, from -1 (to its back) to 1; 0 for straight fingers."""

    def at(name: str) -> np.ndarray:
        return positions[:, skeleton.joint(f"{side}_{name}")]

    along = at("middle_1") - at("wrist")
    palm = unit(np.cross(at("index_1") - at("pinky_1"), along) * (1 if side == "right" else -1))
    bends = []
    for finger in FOUR_FINGERS:
        first, second = at(f"{finger}_2") - at(f"{finger}_1"), at(f"{finger}_3") - at(f"{finger}_2")
        # The second bone is bent against the first, which flat hands do not show.
        bends.append(np.sum((unit(second) - unit(first)) * palm, axis=-1))
    return float(np.clip(2 * np.median(bends), -1, 1))


def add_face(
    positions: np.ndarray, head_positions: np.ndarray, head_rotations: np.ndarray, skeleton: Skeleton, *, up: str = "y"
) -> np.ndarray:
    """Set the joints of the face of a motion: points fixed on the head, which show its rotation.

    Rest poses are not reliable, because many files store every bone along its own axis. Therefore the head is assumed
    to look ahead on average. M, the mean over the frames of heading^-1 head, is the rotation of an upright head that
    faces where the shoulders face, and head M^-1 is the rotation of the face in each frame. The points are placed so
    that their mean offset from the middle of the shoulders is that of the mean pose, because formats put the neck, but
    not the shoulders, at different heights.

    Args:
        positions: (T, joints, 3) metres, right-handed, with both shoulders; the joints of the face are ignored.
        head_positions: (T, 3) metres, position of the joint that the head rotates about.
        head_rotations: (T, 3, 3) rotation of the head in the same coordinates, from any rest pose.
    """
    heading, reliance = _headings(positions, skeleton, up)
    body, head = Rotation.from_matrix(heading), Rotation.from_matrix(head_rotations)
    weights = reliance if reliance.any() else None
    ahead = (body.inv() * head).mean(weights)
    facing = head * ahead.inv()
    shoulders = [skeleton.joint("left_shoulder"), skeleton.joint("right_shoulder")]
    to_head = body.inv().apply(head_positions - positions[:, shoulders].mean(axis=1))
    mean_to_head = np.average(to_head, axis=0, weights=weights)
    places = skeleton.mean_pose - skeleton.mean_pose[shoulders].mean(axis=0) - mean_to_head
    completed = np.array(positions, np.float64)
    for joint in (index for index, name in enumerate(skeleton.joints) if name in FACE):
        completed[:, joint] = head_positions + facing.apply(places[joint])
    return completed


def add_rest_face(positions: np.ndarray, head_rotations: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Set the joints of the face where those of the T-pose are after the rotation of the head about the neck.

    Args:
        positions: (T, joints, 3) metres, y up; the joints of the face are ignored.
        head_rotations: (T, 3, 3) rotation of the head from the T-pose, in which it looks along +z.
    """
    armature, neck = ha2g_armature(skeleton), positions[:, skeleton.joint("neck")]
    _, rest = rest_positions(armature)
    completed = np.array(positions, np.float64)
    for joint in (name for name in FACE if name in skeleton.joints):
        bone = rest[armature.joint(joint)] - rest[armature.joint("neck")]
        completed[:, skeleton.joint(joint)] = neck + head_rotations @ bone
    return completed


def from_captured(positions: np.ndarray, rotations: np.ndarray, spine: np.ndarray) -> LowerBody:
    """Find the rotations of pelvis and legs from the T-pose, and the bones of the T-pose.

    Rest poses are not reliable, because many files store every bone along its own axis. A joint rotates as in the file,
    and only the constant rotation from the T-pose is found: its bone is straight in the T-pose, and its left is on
    average that of the pelvis, whose left is the line of the hips and which is upright on average.

    Args:
        positions: (T, 9, 3) metres of `lower_body.JOINTS`, y up, facing +z; NaN for feet that the file lacks. The
            bones of hips, thighs and shins have a length; feet at their ankles are taken as lacking.
        rotations: (T, 9, 3, 3) rotations of the joints in these axes, from any rest pose.
        spine: (T, 3) metres of the joint `spine` of the skeleton.
    """
    names = {name: index for index, name in enumerate(JOINTS)}
    own = [Rotation.from_matrix(rotations[:, joint]) for joint in range(len(JOINTS))]
    hips = positions[:, names["left_hip"]] - positions[:, names["right_hip"]]
    found: dict[str, Rotation] = {}
    up = np.tile(-_DOWN, (len(hips), 1))
    found["pelvis"] = own[0] * _constant(own[0], hips, LEFT, up, -_DOWN)
    offsets = np.zeros((len(JOINTS) + 1, 3))
    offsets[-1] = _mean_offset(found["pelvis"], spine - positions[:, 0])
    for side in ("left", "right"):
        hip, knee, ankle, foot = (names[f"{side}_{part}"] for part in ("hip", "knee", "ankle", "foot"))
        offsets[hip] = _mean_offset(found["pelvis"], positions[:, hip] - positions[:, 0])
        lateral = found["pelvis"].apply(LEFT)
        for joint, end in ((hip, knee), (knee, ankle)):
            bone = positions[:, end] - positions[:, joint]
            found[JOINTS[joint]] = own[joint] * _constant(own[joint], bone, _DOWN, lateral, LEFT)
            lateral = found[JOINTS[joint]].apply(LEFT)
            offsets[end] = _DOWN * np.linalg.norm(bone, axis=-1).mean()
        shin, ankle_name, foot_name = found[f"{side}_knee"], JOINTS[ankle], JOINTS[foot]
        bone = positions[:, foot] - positions[:, ankle]
        length = np.linalg.norm(bone, axis=-1).mean()
        if length > MIN_BONE:  # which NaN is not
            found[ankle_name] = own[ankle] * _constant(own[ankle], bone, _FOOT, lateral, LEFT)
            found[foot_name] = _like(own[foot], found[ankle_name])
        else:
            length = _FOOT_LENGTH
            found[ankle_name] = found[foot_name] = _like(own[ankle], shin)
        offsets[foot] = length * _FOOT / np.linalg.norm(_FOOT)
    quaternions = np.stack([found[name].as_quat() for name in JOINTS], axis=1)
    return LowerBody(offsets.astype(np.float32), quaternions.astype(np.float32), positions[:, 0].astype(np.float32))


def from_rest_pose(rest: np.ndarray, rotations: np.ndarray, pelvis: np.ndarray, spine: np.ndarray) -> LowerBody:
    """Return the lower body of a file whose rest pose is the T-pose, as that of SMPL-X is.

    Args:
        rest: (9, 3) metres of `lower_body.JOINTS` in the T-pose.
        rotations: (T, 9, 3, 3) rotations of the joints in the world, none in the T-pose.
        pelvis, spine: (T, 3) metres of the pelvis and of the joint `spine` of the skeleton.
    """
    chest = _mean_offset(Rotation.from_matrix(rotations[:, 0]), spine - pelvis)
    offsets = np.array([*(rest[joint] - rest[max(parent, 0)] for joint, parent in enumerate(PARENTS)), chest])
    quaternions = np.stack([Rotation.from_matrix(rotations[:, i]).as_quat() for i in range(len(JOINTS))], axis=1)
    return LowerBody(offsets.astype(np.float32), quaternions.astype(np.float32), pelvis.astype(np.float32))


def _constant(
    own: Rotation, exact: np.ndarray, exact_rest: np.ndarray, about: np.ndarray, rest: np.ndarray
) -> Rotation:
    """Return the rotation from the T-pose to the axes of a joint with rotations `own`.

    Args:
        exact, exact_rest: (T, 3) vectors that are constant in the axes of the joint, and (3,) the same in the T-pose.
        about, rest: (T, 3) vectors that are constant only on average, and (3,) the same in the T-pose.
    """
    first = own.inv().apply(exact).mean(axis=0)
    second = own.inv().apply(about).mean(axis=0)
    return Rotation.from_matrix(_axes(first, second) @ _axes(exact_rest, rest).T)


def _axes(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (3, 3) axes as columns: along the first vector, across it towards the second, and across both."""
    x = first / np.linalg.norm(first)
    y = second - (second @ x) * x
    y = y / max(float(np.linalg.norm(y)), 1e-12)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _like(own: Rotation, other: Rotation) -> Rotation:
    """Return rotations of a joint that are on average those of another joint."""
    return own * (own.inv() * other).mean()


def _mean_offset(rotation: Rotation, bone: np.ndarray) -> np.ndarray:
    return rotation.inv().apply(bone).mean(axis=0)
