"""The outlines of a figure have no gaps, are drawn in the right order, and fit the view."""

import numpy as np
import pytest
from figure.poses import GREEN, POSES, WIDE, is_background, pixels_of, posed, poses_of
from scipy import ndimage

from ha2g_jax import figure
from ha2g_jax import skeleton as skeletons
from ha2g_jax.figure import arm_ranks, from_the_front
from ha2g_jax.figure.face import head_frame, head_shapes
from ha2g_jax.figure.limbs import hand_parts
from ha2g_jax.figure.shapes import capsules, enlarged, hull, project


@pytest.mark.parametrize("name", skeletons.SKELETONS)
def test_there_is_no_gap_at_a_joint_along_a_bone_or_in_the_chest(name):
    """The trunk had notches where an arm left it, and a limb that points to the camera lost half of its disc."""
    skeleton, size = skeletons.load_skeleton(name), 480
    bones = [bone for bone in skeleton.bones if not skeleton.joints[bone[1]].endswith(("nose", "head", "eye", "ear"))]
    starts, ends = (list(joints) for joints in zip(*bones, strict=True))
    along = np.linspace(0, 1, 25)[:, None, None]
    for pose in poses_of(name):
        view = figure.fit([(pose[None], skeleton)])
        picture = figure.draw_figure(pose, skeleton, GREEN, size, size, view)
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


CIRCLE = np.stack([np.cos(np.arange(12) * np.pi / 6), np.sin(np.arange(12) * np.pi / 6), np.zeros(12)], axis=-1)


@pytest.mark.parametrize("yaw", [-60, -35, 0, 35, 60])
@pytest.mark.parametrize("pitch", [-25, 0, 25])
def test_there_is_no_gap_in_a_head_that_is_turned(yaw, pitch):
    """Between the hair over the forehead and the hair behind it, the background was visible."""
    skeleton, size = skeletons.load_skeleton("ted_expressive"), 600
    pose = skeletons.directions_to_positions(skeleton, skeleton.mean_directions)
    face = [skeleton.joint(joint) for joint in ("nose", "left_eye", "right_eye", "left_ear", "right_ear")]
    neck, angles = pose[skeleton.joint("neck")], np.deg2rad([yaw, pitch])
    pose[face] = neck + (pose[face] - neck) @ turn(1, angles[0]) @ turn(0, angles[1])
    points = from_the_front(pose[None], skeleton)
    picture = figure.draw_figure(pose, skeleton, GREEN, size, size)
    columns, rows = np.meshgrid(np.arange(size), np.arange(size))
    y, x = pixels_of(head_frame(points)[0], size, figure.DEFAULT_VIEW)
    inside = np.hypot(columns - x, rows - y) < 0.092 * size / 1.12
    assert inside.sum() > 5000
    assert not is_background(picture)[inside].any()
    holes: np.ndarray = ndimage.label(is_background(picture))[0]  # pyright: ignore
    assert set(np.unique(holes[: y[0]])) <= {0, holes[0, 0]}  # above the centre, all of the background is outside


def turn(axis: int, angle: float) -> np.ndarray:
    first, second = (index for index in range(3) if index != axis)
    matrix = np.eye(3)
    matrix[[first, second], [first, second]] = np.cos(angle)
    matrix[first, second], matrix[second, first] = np.sin(angle), -np.sin(angle)
    return matrix


@pytest.mark.parametrize(("detail", "share"), [(1, 0.03), (2, 0.01)])
def test_a_limb_is_the_hull_of_its_discs(detail, share):
    """Also where it points to the camera, so that one disc is within the other."""
    random = np.random.default_rng(3)
    starts, ends = random.normal(0, 0.1, (2, 200, 3, 3))
    ends[:100, :, :2] = starts[:100, :, :2] + random.normal(0, 0.005, (100, 3, 2))
    wide, narrow = np.array([0.05, 0.03, 0.02]), np.array([0.03, 0.03, 0.06])
    angles = np.linspace(0, 2 * np.pi, 50)
    directions = np.stack([np.cos(angles), np.sin(angles)])
    for limb, outline in enumerate(capsules(starts, ends, wide, narrow, detail)):
        centres, radii = np.stack([starts[:, limb], ends[:, limb]], axis=1), np.array([wide[limb], narrow[limb]])
        reach = (project(centres) @ directions + (radii * enlarged(centres[..., 2]))[..., None]).max(axis=1)
        for shape in (outline, hull(centres, radii, detail)):
            edges = np.roll(shape, -1, axis=1) - shape
            after = np.roll(edges, -1, axis=1)
            turns = edges[..., 0] * after[..., 1] - edges[..., 1] * after[..., 0]
            assert turns.min() > -1e-7
            short = reach - (shape @ directions).max(axis=1)
            assert short.min() > -1e-9 and short.max() < share * radii.max() * 1.2


def test_hands_are_behind_the_head_or_in_front_of_it():
    skeleton, size = skeletons.load_skeleton("ted_gesture"), 240
    heads, rows, columns = [], slice(0, 100), slice(90, 150)
    for depth in (0.45, -0.45):
        sides = {f"{side}_elbow": (sign, -0.8, depth) for side, sign in (("left", 1), ("right", -1))}
        sides |= {f"{side}_wrist": (-sign, -0.35, depth / 3) for side, sign in (("left", 1), ("right", -1))}
        heads.append(figure.draw_figure(posed(skeleton, sides), skeleton, GREEN, size, size)[rows, columns])
    down = figure.draw_figure(posed(skeleton, {}), skeleton, GREEN, size, size)[rows, columns]
    in_front = [(np.abs(head.astype(int) - down).sum(axis=-1) > 60)[~is_background(down)].mean() for head in heads]
    assert in_front[0] < 0.03 < 0.1 < in_front[1]


@pytest.mark.parametrize("near", ["left", "right"])
def test_the_arm_that_is_nearer_where_arms_cross_is_in_front(near):
    skeleton = skeletons.load_skeleton("ted_expressive")
    crossed = {}
    for side, sign in (("left", 1), ("right", -1)):
        crossed[f"{side}_elbow"] = (0.2 * sign, 0.9, -0.5 if side == near else -0.1)
        crossed[f"{side}_wrist"] = (-0.9 * sign, -0.4, -0.3)
    points = from_the_front(posed(skeleton, crossed)[None], skeleton)
    ranks = dict(zip(("left", "right"), arm_ranks(points, head_frame(points)[0]), strict=True))
    far = "right" if near == "left" else "left"
    assert ranks[near].lower > ranks[far].lower >= 0
    assert (ranks[near].upper >= 0).all()


@pytest.mark.parametrize("length", [1.0, 1.6])
@pytest.mark.parametrize("name", skeletons.SKELETONS)
def test_the_view_contains_the_figure_at_any_amplitude(name, length):
    skeleton = skeletons.load_skeleton(name)
    random = np.random.default_rng(2).normal(size=(60, skeleton.num_bones, 3))
    for strength in (0.2, 1.0, 100.0):
        directions = skeleton.mean_directions + strength * random
        clip = length * skeletons.directions_to_positions(skeleton, directions)
        view = figure.fit([(clip, skeleton)])
        points = from_the_front(clip, skeleton)
        hands = [hand_parts(points, side, figure.DEFAULT_LOOK, 1) for side in ("left", "right")]
        drawn = [shape.outline for parts in hands for part in parts for shape in part.shapes]
        drawn += [shape.outline for shape in head_shapes(points, head_frame(points), figure.DEFAULT_LOOK, 1)]
        drawn.append(project(np.stack(list(points.values()), axis=1)))
        for width, height in ((720, 720), (640, 360), (300, 500)):
            scale, spine = view.place(width, height)
            places = np.concatenate(drawn, axis=1) * scale + spine
            assert (places > 0.02 * scale).all()
            assert (places < np.array([width, height]) - 0.02 * scale).all()


def test_a_view_is_never_smaller_than_the_default_and_that_of_two_motions_contains_both():
    skeleton = skeletons.load_skeleton("ted_expressive")
    calm, wide, high = (posed(skeleton, bones)[None] for bones in ({}, WIDE, POSES["up"]))
    assert figure.fit([(calm, skeleton)]) == figure.fit([]) == figure.DEFAULT_VIEW
    alone = [np.array(figure.fit([(clip, skeleton)])) for clip in (wide, high)]
    both = np.array(figure.fit([(wide, skeleton), (high, skeleton)]))
    np.testing.assert_array_equal(both[:2], np.minimum(*alone)[:2])
    np.testing.assert_array_equal(both[2:], np.maximum(*alone)[2:])
    assert both[0] < -0.9 and both[1] < -0.9 and both[2] > 0.9
