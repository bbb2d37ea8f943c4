"""MediaPipe's landmarks become keypoints in the right axes, at the right joints, of the right size."""

import io
import struct

import numpy as np
import pytest

from ha2g_jax.importers.video import holistic
from ha2g_jax.importers.video.keypoints import from_holistic
from ha2g_jax.skeleton import load_skeleton, positions_to_directions

SKELETON = load_skeleton("ted_expressive")
SIZE = (640, 480)


def person() -> tuple[np.ndarray, np.ndarray]:
    """World and image landmarks of somebody who faces the camera, upright, arms down; hips at the origin."""
    world = np.zeros((33, 4), np.float32)
    world[:, 3] = 1
    places = {
        0: (0, -0.7, -0.15),
        2: (0.03, -0.74, -0.12),
        5: (-0.03, -0.74, -0.12),
        7: (0.07, -0.72, 0),
        8: (-0.07, -0.72, 0),
    }
    for side, sign in ((11, 1), (12, -1)):
        places |= {
            side: (sign * 0.17, -0.5, 0),
            side + 2: (sign * 0.2, -0.25, 0.02),
            side + 4: (sign * 0.2, -0.2, -0.22),
            side + 12: (sign * 0.1, 0, 0),
        }
    for landmark, place in places.items():
        world[landmark, :3] = place
    image = np.array([320, 400]) + 400 * world[:, :2]
    return world[None], image[None].astype(np.float32)


def hand(wrist: np.ndarray, palm: float, toward: np.ndarray) -> np.ndarray:
    """21 landmarks: every finger stretched out from the wrist, in pixels."""
    marks = np.zeros((21, 3))
    for finger in range(5):
        marks[1 + 4 * finger : 5 + 4 * finger] = np.outer([1, 1.5, 1.8, 2], toward) * palm
    marks[:, :2] += wrist
    return marks[None].astype(np.float32)


def seen(world, image, left, right):
    return from_holistic(world, image, left, right, np.array([SIZE], np.float32))


UNSEEN = np.full((1, 21, 3), np.nan, np.float32)


def test_the_body_is_where_the_skeleton_has_it():
    world, image = person()
    found = seen(world, image, UNSEEN, UNSEEN)
    body = [number for number, name in enumerate(SKELETON.joints) if not name[-1].isdigit()]
    assert (found.confidence[0, body] == 1).all()
    assert (np.delete(found.confidence[0], body) == 0).all()
    assert np.isnan(np.delete(found.positions[0], body, axis=0)).all()
    positions = found.positions[0]
    np.testing.assert_allclose(positions[SKELETON.joint("left_wrist")], (0.2, -0.2, -0.22), rtol=1e-6)
    np.testing.assert_allclose(positions[SKELETON.joint("right_eye")], (-0.03, -0.74, -0.12), rtol=1e-6)
    directions = positions_to_directions(SKELETON, found.positions)[0]
    for child in ("neck", "left_shoulder", "right_shoulder", "nose", "right_ear", "left_ear"):
        wanted = SKELETON.mean_directions[SKELETON.bone(child)]
        assert directions[SKELETON.bone(child)] @ wanted / np.linalg.norm(wanted) > 0.95, child
    length = np.linalg.norm(positions[SKELETON.joint("neck")] - positions[SKELETON.joint("spine")])
    assert length == pytest.approx(SKELETON.lengths[SKELETON.bone("neck")], rel=0.1)


def test_a_hand_hangs_on_its_wrist_in_metres():
    world, image = person()
    toward = np.array([0.0, -0.6, -0.8])
    found = seen(world, image, UNSEEN, hand(image[0, 16] + 3, 50.0, toward))
    wrist = found.positions[0, SKELETON.joint("right_wrist")]
    np.testing.assert_allclose(wrist, world[0, 16, :3])
    for finger in ("thumb", "index", "middle", "ring", "pinky"):
        for number, factor in ((1, 1), (2, 1.5), (3, 1.8)):
            joint = SKELETON.joint(f"right_{finger}_{number}")
            np.testing.assert_allclose(found.positions[0, joint] - wrist, 0.088 * factor * toward, atol=1e-6)
            assert found.confidence[0, joint] == 1
    np.testing.assert_allclose(
        found.image_points[0, SKELETON.joint("right_middle_1")], image[0, 16] + 3 + 50 * toward[:2], rtol=1e-5
    )
    assert found.confidence[0, SKELETON.joint("left_middle_1")] == 0


def test_a_speaker_behind_a_desk_counts_as_seen_and_a_close_up_does_not():
    world, image = person()
    world[:, 23:, 3] = 0.01  # hips and legs
    spine = SKELETON.joint("spine")
    assert seen(world, image, UNSEEN, UNSEEN).confidence[0, spine] == 1
    assert seen(world, image + np.array([0, 200], np.float32), UNSEEN, UNSEEN).confidence[0, spine] == pytest.approx(
        0.01
    )


def test_nobody_is_nowhere():
    found = seen(np.full((1, 33, 4), np.nan, np.float32), np.full((1, 33, 2), np.nan, np.float32), UNSEEN, UNSEEN)
    assert np.isnan(found.positions).all()
    assert np.isnan(found.image_points).all()
    assert (found.confidence == 0).all()


def test_a_hand_that_is_not_at_its_wrist_is_none():
    wrists = np.array([[400.0, 300.0], [200.0, 300.0]])
    up = np.array([0, -1.0, 0])
    left, right = (hand(wrist, 50, up)[0] for wrist in wrists)
    assert holistic.which_fit(np.stack([left, right]), wrists).tolist() == [True, True]
    assert holistic.which_fit(np.stack([left, left]), wrists).tolist() == [True, False]
    assert holistic.which_fit(np.stack([UNSEEN[0], right]), wrists).tolist() == [False, True]
    near = wrists.copy()
    near[0] = wrists[1] + [30, 0]  # the arms cross: both wrists are near, the hand is the nearer one's
    assert holistic.which_fit(np.stack([right, right]), near).tolist() == [False, True]
    assert holistic.which_fit(np.stack([left, right]), np.full((2, 2), np.nan)).tolist() == [False, False]


def test_images_come_out_of_the_stream_as_they_went_in():
    images = [np.random.default_rng(size).integers(0, 255, (size, size + 3, 3), np.uint8) for size in (4, 9)]
    stream = b"".join(struct.pack("<2I", *image.shape[1::-1]) + image.tobytes() for image in images)
    for found, image in zip(holistic.read_images(io.BytesIO(stream)), images, strict=True):
        np.testing.assert_array_equal(found, image)
    with pytest.raises(EOFError):
        list(holistic.read_images(io.BytesIO(stream[:-1])))
