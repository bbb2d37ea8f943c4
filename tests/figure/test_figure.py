"""Drawing of a pose."""

import numpy as np
import pytest
from figure.poses import WIDE, posed, random_poses

from ha2g_jax import figure
from ha2g_jax import skeleton as skeletons
from ha2g_jax.figure import outline, stage


@pytest.mark.parametrize("name", skeletons.SKELETONS)
def test_draws_a_person_on_a_background(name):
    skeleton = skeletons.load_skeleton(name)
    picture = figure.draw_figure(skeleton.mean_pose, skeleton, figure.DEFAULT_LOOK, 160, 120)
    assert picture.shape == (120, 160, 3)
    assert picture.dtype == np.uint8
    shirt = np.abs(picture.astype(int) - figure.DEFAULT_LOOK.shirt).sum(axis=-1) < 30
    assert 0.05 < shirt.mean() < 0.5
    # Antialiased: many more colours than shapes.
    assert len(np.unique(picture[20:100, 40:120].reshape(-1, 3), axis=0)) > 100


def test_left_of_the_person_is_right_in_the_picture():
    skeleton = skeletons.load_skeleton("ted_expressive")
    pose = skeleton.mean_pose.copy()
    left_arm = [index for index, joint in enumerate(skeleton.joints) if joint.startswith("left_") and index > 3]
    hands_down = figure.draw_figure(pose, skeleton, figure.DEFAULT_LOOK, 120, 120).astype(int)
    pose[[index for index in left_arm if skeleton.joints[index] not in ("left_eye", "left_ear")], 1] -= 0.15
    changed = np.abs(figure.draw_figure(pose, skeleton, figure.DEFAULT_LOOK, 120, 120) - hands_down).sum(axis=-1) > 40
    assert changed[:, 60:].sum() > 5 * changed[:, :55].sum()


def test_place_in_the_room_does_not_matter():
    skeleton = skeletons.load_skeleton("ted_expressive")
    pictures = [
        figure.draw_figure(skeleton.mean_pose + shift, skeleton, figure.DEFAULT_LOOK, 64, 64).astype(int)
        for shift in (0.0, 3.0)
    ]
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.1


@pytest.mark.parametrize("name", skeletons.SKELETONS)
def test_many_poses_are_outlined_as_each_alone(name):
    skeleton, poses = skeletons.load_skeleton(name), random_poses(name, 20)
    together = outline(poses, skeleton, figure.DEFAULT_LOOK)
    alone = [outline(pose[None], skeleton, figure.DEFAULT_LOOK) for pose in poses]
    np.testing.assert_allclose(together.points, np.concatenate([each.points for each in alone]), atol=1e-12)
    np.testing.assert_array_equal(together.order, np.concatenate([each.order for each in alone]))
    np.testing.assert_array_equal(np.sort(together.order), np.tile(np.arange(len(together.colours)), (20, 1)))
    assert len(np.unique(together.order, axis=0)) > 1  # the nearer arm, and nearer fingers, come last


def test_more_detail_is_the_same_figure_with_rounder_curves():
    skeleton, poses = skeletons.load_skeleton("ted_expressive"), random_poses("ted_expressive", 3)
    plain, round_ = (outline(poses, skeleton, figure.DEFAULT_LOOK, detail) for detail in (1, 2))
    assert plain.colours == round_.colours
    assert round_.points.shape[1] > 1.2 * plain.points.shape[1]
    for ends in (np.min, np.max):
        np.testing.assert_allclose(ends(plain.points, axis=1), ends(round_.points, axis=1), atol=0.003)


@pytest.mark.parametrize(
    ("count", "size", "columns", "rows"),
    [
        (1, (1920, 1080), 1, 1),
        (2, (1920, 1080), 2, 1),
        (4, (1920, 1080), 2, 2),
        (6, (1920, 1080), 3, 2),
        (2, (500, 1000), 1, 2),
        (3, (192, 64), 3, 1),
        (5, (300, 180), 3, 2),
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
    skeleton = skeletons.load_skeleton("ted_expressive")
    wide = posed(skeleton, WIDE)[None]
    empty = stage.set_stage(["", ""], figure.DEFAULT_LOOK.background, 160, 80)
    drawings = [stage.draw(empty, 0, 3 * wide, skeleton, figure.DEFAULT_LOOK)]
    planes = [np.zeros_like(plane) for plane in empty.clean]
    stage.paint(empty, drawings, 0, planes)
    for plane, clean in zip(planes, empty.clean, strict=True):
        half = plane.shape[1] // 2
        np.testing.assert_array_equal(plane[:, half:], clean[:, half:])
        assert (plane[:, :half] != clean[:, :half]).mean() > 0.2


def test_a_name_is_written_as_small_as_it_must_be():
    background = figure.DEFAULT_LOOK.background
    plain = stage.set_stage([""], background, 320, 160).clean[0].astype(int)
    widths = []
    for name in ("one", "a name much longer than there is room for it in such a small picture, even so", "x" * 200):
        written = np.abs(stage.set_stage([name], background, 320, 160).clean[0] - plain) > 20
        assert written.any()
        widths.append(np.flatnonzero(written.any(axis=0)))
    assert widths[0].max() < 80
    assert all(250 < columns.max() < 319 for columns in widths[1:])
    first, second = (
        stage.set_stage([f"a run with a name of this length, seed {n}"], background, 320, 160) for n in (0, 1)
    )
    assert (first.clean[0] != second.clean[0]).any()  # its end is not cut
