"""A figure has no gaps, is drawn in the right order, fits the view, and stays in its panel of a video."""

from collections.abc import Mapping

import numpy as np
import pytest

from ha2g_jax.figure import (
    CAMERAS,
    DEFAULT_LOOK,
    DEFAULT_VIEW,
    View,
    align,
    arm_ranks,
    draw_figure,
    fit,
    from_the_front,
    outline,
    stage,
)
from ha2g_jax.figure.person import EYES, face_features, hand_parts, head_frame, head_shapes
from ha2g_jax.figure.shapes import capsules, enlarged, hull, project
from ha2g_jax.skeleton import SKELETONS, Skeleton, directions_to_positions, load_skeleton

GREEN = DEFAULT_LOOK._replace(background=(0, 255, 0))
Bones = Mapping[str, tuple[float, float, float]]


def posed(skeleton: Skeleton, bones: Bones) -> np.ndarray:
    """(joints, 3) mean pose with directions of some bones, by the joint at their ends; x is the person's left."""
    turn = -1 if skeleton.name == "ted_gesture" else 1
    directions = skeleton.mean_directions.copy()
    for joint, direction in bones.items():
        directions[skeleton.bone(joint)] = np.array(direction) * (turn, 1, turn)
    return directions_to_positions(skeleton, directions)


CIRCLE = np.stack([np.cos(np.arange(12) * np.pi / 6), np.sin(np.arange(12) * np.pi / 6), np.zeros(12)], axis=-1)
WIDE = {"left_elbow": (1, 0, 0), "left_wrist": (1, 0, 0), "right_elbow": (-1, 0, 0), "right_wrist": (-1, 0, 0)}
POSES: dict[str, Bones] = {
    "crossed": {"left_elbow": (0.2, 0.9, -0.4), "left_wrist": (-0.9, -0.4, -0.3)}
    | {"right_elbow": (-0.2, 0.9, -0.3), "right_wrist": (0.9, -0.4, -0.3)},
    "to the camera": {"left_elbow": (0, 0.1, -1), "left_wrist": (0, 0, -1), "right_elbow": (0, -0.1, -1)}
    | {"right_wrist": (0, 0.02, -1)},
    "away": {"left_elbow": (0, 0.1, 1), "left_wrist": (0.02, 0, 1), "right_elbow": (0, 1, 0)}
    | {"right_wrist": (0, -1, 0)},
    "up": {"left_elbow": (0.1, -1, 0), "left_wrist": (0, -1, 0), "right_elbow": (-1, -1, 0), "right_wrist": (1, -1, 0)},
    "shrug": {"left_shoulder": (1, -0.5, 0), "right_shoulder": (-1, -0.5, 0.2), "neck": (0.3, -1, -0.2)},
    "turned": {"left_shoulder": (0.3, 0.1, 1), "right_shoulder": (-0.3, 0.1, -1)},
}


def random_poses(name: str, count: int) -> np.ndarray:
    """(count, joints, 3) poses about the mean."""
    skeleton = load_skeleton(name)
    noise = np.random.default_rng(0).normal(0, 0.3, (count, skeleton.num_bones, 3))
    return directions_to_positions(skeleton, skeleton.mean_directions + noise)


def poses_of(name: str) -> np.ndarray:
    """(T, joints, 3) poses by name, poses about the mean, and poses with arms and hands in any direction."""
    skeleton = load_skeleton(name)
    random = np.random.default_rng(1)
    directions = skeleton.mean_directions + random.normal(0, 0.1, (40, skeleton.num_bones, 3))
    limbs = [skeleton.bone(f"{side}_{joint}") for side in ("left", "right") for joint in ("elbow", "wrist")]
    limbs += [bone for bone, (_, end) in enumerate(skeleton.bones) if skeleton.joints[end][-2:] in ("_1", "_2", "_3")]
    directions[:, limbs] = random.normal(size=(40, len(limbs), 3))
    named = [posed(skeleton, bones) for bones in POSES.values()]
    return np.concatenate([named, random_poses(name, 10), directions_to_positions(skeleton, directions)])


def is_background(picture: np.ndarray) -> np.ndarray:
    """Where the `GREEN` of the background is more than half of a pixel."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return green - np.maximum(red, blue) > 110


def pixels_of(places: np.ndarray, size: int, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of places (..., 3) about the spine, in which the person faces -z."""
    scale, spine = view.place(size, size)
    x, y = np.moveaxis(np.floor(project(places) * scale + spine).astype(int), -1, 0)
    return y, x


def test_left_of_the_person_is_right_in_the_picture():
    skeleton = load_skeleton("ted_expressive")
    pose = skeleton.mean_pose.copy()
    left_arm = [index for index, joint in enumerate(skeleton.joints) if joint.startswith("left_") and index > 3]
    hands_down = draw_figure(pose, skeleton, DEFAULT_LOOK, 120, 120).astype(int)
    pose[[index for index in left_arm if skeleton.joints[index] not in ("left_eye", "left_ear")], 1] -= 0.15
    changed = np.abs(draw_figure(pose, skeleton, DEFAULT_LOOK, 120, 120) - hands_down).sum(axis=-1) > 40
    assert changed[:, 60:].sum() > 5 * changed[:, :55].sum()


@pytest.mark.parametrize("name", SKELETONS)
def test_many_poses_are_outlined_as_each_alone(name):
    skeleton, poses = load_skeleton(name), random_poses(name, 20)
    together = outline(poses, skeleton, DEFAULT_LOOK)
    alone = [outline(pose[None], skeleton, DEFAULT_LOOK) for pose in poses]
    np.testing.assert_allclose(together.points, np.concatenate([each.points for each in alone]), atol=1e-12)
    np.testing.assert_array_equal(together.order, np.concatenate([each.order for each in alone]))
    np.testing.assert_array_equal(np.sort(together.order), np.tile(np.arange(len(together.colours)), (20, 1)))
    assert len(np.unique(together.order, axis=0)) > 1  # the nearer arm, and nearer fingers, come last


@pytest.mark.parametrize(
    ("count", "size", "columns", "rows"),
    [
        *((count, (1920, 1080), *grid) for count, grid in ((1, (1, 1)), (2, (2, 1)), (4, (2, 2)), (6, (3, 2)))),
        *((2, (500, 1000), 1, 2), (3, (192, 64), 3, 1), (5, (300, 180), 3, 2)),
    ],
)
def test_panels_fill_the_picture_and_do_not_overlap(count, size, columns, rows):
    panels = stage.panels(count, *size)
    assert len(panels) == count
    assert len({panel.left for panel in panels}) == columns
    assert len({panel.top for panel in panels}) == rows
    covered = np.zeros(size[::-1], int)
    for panel in panels:
        assert all(side % 2 == 0 for side in panel)
        covered[panel.top : panel.top + panel.height, panel.left : panel.left + panel.width] += 1
    assert covered.max() == 1
    if count == columns * rows:
        assert covered.min() == 1


def test_a_figure_stays_in_its_panel():
    skeleton = load_skeleton("ted_expressive")
    wide = posed(skeleton, WIDE)[None]
    empty = stage.set_stage(["", ""], DEFAULT_LOOK.background, 160, 80, 2 * [DEFAULT_VIEW])
    drawings = [stage.draw(empty, 0, 3 * wide, skeleton, DEFAULT_LOOK)]
    planes = [np.zeros_like(plane) for plane in empty.clean]
    stage.paint(empty, drawings, 0, planes)
    for plane, clean in zip(planes, empty.clean, strict=True):
        half = plane.shape[1] // 2
        np.testing.assert_array_equal(plane[:, half:], clean[:, half:])
        assert (plane[:, :half] != clean[:, :half]).mean() > 0.2


@pytest.mark.parametrize("name", SKELETONS)
def test_there_is_no_gap_at_a_joint_along_a_bone_or_in_the_chest(name):
    """The trunk had notches where an arm left it, and a limb that points to the camera lost half of its disc."""
    skeleton, size = load_skeleton(name), 480
    bones = [bone for bone in skeleton.bones if not skeleton.joints[bone[1]].endswith(("nose", "head", "eye", "ear"))]
    starts, ends = (list(joints) for joints in zip(*bones, strict=True))
    along = np.linspace(0, 1, 25)[:, None, None]
    for pose in poses_of(name):
        view = fit([(pose[None], skeleton)])
        picture = draw_figure(pose, skeleton, GREEN, size, size, view)
        points = from_the_front(pose[None], skeleton)
        joints = np.concatenate([points[joint] for joint in skeleton.joints])
        shoulders = points["left_shoulder"] + along * (points["right_shoulder"] - points["left_shoulder"])
        chest = points["spine"] + np.linspace(0, 1, 9)[:, None] * (shoulders - points["spine"])
        discs = [
            points[f"{side}_{joint}"][:, None] + radius * CIRCLE
            for side in ("left", "right")
            for joint, radius in (("shoulder", 0.045), ("elbow", 0.036), ("wrist", 0.020))
        ]
        for places in (joints[starts] + along * (joints[ends] - joints[starts]), chest, np.concatenate(discs)):
            assert not is_background(picture[pixels_of(places, size, view)]).any()


@pytest.mark.parametrize(("detail", "share"), [(1, 0.03), (2, 0.01)])
def test_a_limb_is_the_hull_of_its_discs(detail, share):
    """Also where it points to the camera, so that one disc is within the other."""
    random = np.random.default_rng(3)
    starts, ends = random.normal(0, 0.1, (2, 200, 3, 3))
    ends[:100, :, :2] = starts[:100, :, :2] + random.normal(0, 0.005, (100, 3, 2))
    wide, narrow = np.array([0.05, 0.03, 0.02]), np.array([0.03, 0.03, 0.06])
    angles = np.linspace(0, 2 * np.pi, 50)
    directions = np.stack([np.cos(angles), np.sin(angles)])
    for limb, capsule in enumerate(capsules(starts, ends, wide, narrow, detail)):
        centres, radii = np.stack([starts[:, limb], ends[:, limb]], axis=1), np.array([wide[limb], narrow[limb]])
        reach = (project(centres) @ directions + (radii * enlarged(centres[..., 2]))[..., None]).max(axis=1)
        for shape in (capsule, hull(centres, radii, detail)):
            edges = np.roll(shape, -1, axis=1) - shape
            after = np.roll(edges, -1, axis=1)
            turns = edges[..., 0] * after[..., 1] - edges[..., 1] * after[..., 0]
            assert turns.min() > -1e-7
            short = reach - (shape @ directions).max(axis=1)
            assert short.min() > -1e-9 and short.max() < share * radii.max() * 1.2


@pytest.mark.parametrize("near", ["left", "right"])
def test_the_arm_that_is_nearer_where_arms_cross_is_in_front(near):
    skeleton = load_skeleton("ted_expressive")
    crossed = {}
    for side, sign in (("left", 1), ("right", -1)):
        crossed[f"{side}_elbow"] = (0.2 * sign, 0.9, -0.5 if side == near else -0.1)
        crossed[f"{side}_wrist"] = (-0.9 * sign, -0.4, -0.3)
    points = from_the_front(posed(skeleton, crossed)[None], skeleton)
    ranks = dict(zip(("left", "right"), arm_ranks(points, head_frame(points)[0]), strict=True))
    far = "right" if near == "left" else "left"
    assert ranks[near].lower > ranks[far].lower >= 0
    assert (ranks[near].upper >= 0).all()


@pytest.mark.parametrize("hair_length", [0.0, 1.0])
@pytest.mark.parametrize("name", SKELETONS)
def test_hair_hides_the_face_of_a_person_who_turns_the_back(name, hair_length):
    skeleton, look = load_skeleton(name), DEFAULT_LOOK._replace(hair_length=hair_length)
    front = skeleton.mean_pose
    figure = outline(np.stack([front, front * (-1, 1, -1)]), skeleton, look)
    eyes = [index for index, colour in enumerate(figure.colours) if colour in EYES]
    hair = [index for index, colour in enumerate(figure.colours) if colour == look.hair]
    facing, away = np.argsort(figure.order, axis=1)
    assert facing[eyes].min() > facing[hair].max()
    assert away[eyes].max() < away[hair].max()
    for pose, is_hidden in ((front, False), (front * (-1, 1, -1), True)):
        picture = draw_figure(pose, skeleton, look, 300, 300)
        assert (picture == EYES[1]).all(axis=-1).any() != is_hidden


@pytest.mark.parametrize("length", [1.0, 1.6])
@pytest.mark.parametrize("name", SKELETONS)
def test_the_view_contains_the_figure_at_any_amplitude(name, length):
    skeleton = load_skeleton(name)
    random = np.random.default_rng(2).normal(size=(60, skeleton.num_bones, 3))
    for strength in (0.2, 1.0, 100.0):
        directions = skeleton.mean_directions + strength * random
        clip = length * directions_to_positions(skeleton, directions)
        view = fit([(clip, skeleton)])
        points = from_the_front(clip, skeleton)
        hands = [hand_parts(points, side, DEFAULT_LOOK, 1) for side in ("left", "right")]
        drawn = [shape.outline for parts in hands for part in parts for shape in part.shapes]
        head = head_frame(points)
        drawn += [shape.outline for shape in head_shapes(points, head, DEFAULT_LOOK, 1)]
        drawn += [shape.outline for shape in face_features(head, DEFAULT_LOOK, 1).shapes]
        drawn.append(project(np.stack(list(points.values()), axis=1)))
        for width, height in ((720, 720), (640, 360), (300, 500)):
            scale, spine = view.place(width, height)
            places = np.concatenate(drawn, axis=1) * scale + spine
            assert (places > 0.02 * scale).all()
            assert (places < np.array([width, height]) - 0.02 * scale).all()


@pytest.mark.parametrize("count", [1, 2, 4, 5])
def test_names_are_above_the_figures(count):
    skeleton = load_skeleton("ted_expressive")
    clips = [posed(skeleton, bones)[None] for bones in (*POSES.values(), WIDE)][:count]
    views = align([fit([(clip, skeleton)], CAMERAS["close"]) for clip in clips])
    assert len({(view.top, view.bottom, round(view.right - view.left, 9)) for view in views}) == 1
    names = [f"take {index}" for index in range(count)]
    named, empty = (
        stage.set_stage(each, DEFAULT_LOOK.background, 640, 360, views) for each in (names, ["   "] * count)
    )
    drawings = [stage.draw(named, i, clip, skeleton, DEFAULT_LOOK, views[i]) for i, clip in enumerate(clips)]
    written = np.abs(named.clean[0].astype(int) - empty.clean[0]) > 20
    for panel, drawing in zip(named.panels, drawings, strict=True):
        (left, top), (right, bottom) = drawing.boxes[0]
        assert panel.left < left and panel.top < top and right < panel.left + panel.width
        assert not written[top:bottom, left:right].any()
        assert written[: panel.top + panel.height, panel.left : panel.left + panel.width].any()


def test_cameras_contain_the_hands_and_the_close_one_no_more_than_it_must():
    skeleton = load_skeleton("ted_expressive")
    high, low = posed(skeleton, POSES["up"])[None], posed(skeleton, {})[None]
    close, body = (fit([(high, skeleton)], CAMERAS[name]) for name in ("close", "body"))
    assert close.bottom < 0.2 < 0.5 < body.bottom
    assert close[:3] == body[:3]
    resting = fit([(low, skeleton)], CAMERAS["close"])
    assert resting.bottom > project(from_the_front(low, skeleton)["left_middle_3"])[0, 1] + 0.05


def test_a_view_is_never_smaller_than_the_default_and_that_of_two_motions_contains_both():
    skeleton = load_skeleton("ted_expressive")
    calm, wide, high = (posed(skeleton, bones)[None] for bones in ({}, WIDE, POSES["up"]))
    assert fit([(calm, skeleton)]) == fit([]) == DEFAULT_VIEW
    alone = [np.array(fit([(clip, skeleton)])) for clip in (wide, high)]
    both = np.array(fit([(wide, skeleton), (high, skeleton)]))
    np.testing.assert_array_equal(both[:2], np.minimum(*alone)[:2])
    np.testing.assert_array_equal(both[2:], np.maximum(*alone)[2:])
    assert both[0] < -0.9 and both[1] < -0.9 and both[2] > 0.9
