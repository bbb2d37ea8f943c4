"""Landmarks become keypoints in the right axes and places; cleaned ones are whole, steady, rigid and in time."""

import io
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ha2g_jax.importers.video import holistic
from ha2g_jax.importers.video.keypoints import clean, from_holistic
from ha2g_jax.skeleton import bone_lengths, load_skeleton, positions_to_directions

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


FPS = 30
ELBOW, WRIST = SKELETON.joint("left_elbow"), SKELETON.joint("left_wrist")
FINGERS = [number for number, name in enumerate(SKELETON.joints) if name.startswith("left") and name[-1].isdigit()]


def rotation_by(angle: float) -> np.ndarray:
    """A rotation about an axis across the left forearm."""
    forearm = SKELETON.mean_pose[WRIST] - SKELETON.mean_pose[ELBOW]
    axis = np.cross(forearm, [0, 1, 0])
    return Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()


def waving(count: int, hertz: float = 0.8, size: float = 0.3) -> np.ndarray:
    """A speaker whose left forearm swings about the elbow."""
    positions = np.tile(SKELETON.mean_pose.astype(np.float64), (count, 1, 1))
    for frame in range(count):
        rotation = rotation_by(size * np.sin(2 * np.pi * hertz * frame / FPS))
        below = [WRIST, *FINGERS]
        positions[frame, below] = (
            positions[frame, ELBOW] + (positions[frame, below] - positions[frame, ELBOW]) @ rotation.T
        )
    return positions


def degrees(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angles between the bones of two motions."""
    cosines = np.sum(positions_to_directions(SKELETON, first) * positions_to_directions(SKELETON, second), axis=-1)
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def jerk(positions: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(positions, 3, axis=0), axis=-1).mean())


def test_clean_motion_stays():
    motion = waving(90)
    cleaned = clean(motion, np.ones((90, 43)), FPS)
    assert cleaned.dtype == np.float32
    # The ends of the shot are where a filter knows least; the mean pose is not symmetric, the cleaned one is.
    assert degrees(cleaned, motion).max() < 2


def test_jitter_goes_and_strokes_stay_in_time():
    motion = waving(120)
    noisy = motion + np.random.default_rng(0).normal(0, 0.004, motion.shape)
    cleaned = clean(noisy, np.ones((120, 43)), FPS)
    assert jerk(cleaned) < 0.15 * jerk(noisy)
    swing, wanted = (clip[:, WRIST, 1] - clip[:, WRIST, 1].mean() for clip in (cleaned, motion))
    shifts = range(-3, 4)
    agreement = [np.dot(swing[10:-10], np.roll(wanted, shift)[10:-10]) for shift in shifts]
    assert shifts[int(np.argmax(agreement))] == 0


def test_bones_have_one_length_the_same_on_both_sides():
    motion = waving(60) * np.linspace(0.9, 1.1, 60)[:, None, None]
    found = bone_lengths(SKELETON, clean(motion, np.ones((60, 43)), FPS))
    assert np.ptp(found, axis=0).max() < 1e-6
    np.testing.assert_allclose(found[0], found[0][SKELETON.mirror_bones], atol=1e-6)
    np.testing.assert_allclose(found[0, 0], bone_lengths(SKELETON, SKELETON.mean_pose[None])[0, 0], rtol=0.01)


def test_a_short_gap_is_interpolated_and_a_long_one_held():
    count = 90
    motion = np.tile(SKELETON.mean_pose.astype(np.float64), (count, 1, 1))
    rise = np.linspace(0, 1, count)[:, None] * np.array([0.0, -0.2, 0.0])
    motion[:, [WRIST, *FINGERS]] += rise[:, None]

    def with_gap(start: int, end: int) -> np.ndarray:
        confidence = np.ones((count, 43))
        confidence[start:end, WRIST] = 0
        gapped = np.where(confidence[..., None] > 0, motion, np.nan)
        return clean(gapped, confidence, FPS, cutoff=100.0)

    whole = clean(motion, np.ones((count, 43)), FPS, cutoff=100.0)
    assert degrees(with_gap(40, 50), whole).max() < 1.5
    held = with_gap(20, 70)
    arm = held[:, WRIST] - held[:, ELBOW]
    np.testing.assert_allclose(arm[20:55], np.broadcast_to(arm[19], (35, 3)), atol=1e-6)
    assert np.linalg.norm(arm[69] - arm[70]) < 0.02  # it has moved on before it is seen again
    assert degrees(held[70:], whole[70:]).max() < 0.1


def test_an_unseen_hand_keeps_its_shape_and_goes_with_the_arm():
    motion = waving(90, size=0.8)
    confidence = np.ones((90, 43))
    confidence[30:75, FINGERS] = 0
    cleaned = clean(np.where(confidence[..., None] > 0, motion, np.nan), confidence, FPS, cutoff=100.0)
    assert np.abs(motion[30:75, FINGERS] - motion[29, FINGERS]).max() > 0.1  # the arm did move
    assert degrees(cleaned, motion).max() < 3


def test_what_is_seen_for_a_moment_only_is_no_evidence():
    motion = waving(90, size=0.0)
    confidence = np.ones((90, 43))
    confidence[20:70, FINGERS] = 0
    confidence[40:42, FINGERS] = 1
    motion[40:42, FINGERS] += 0.1
    cleaned = clean(motion, confidence, FPS)
    assert degrees(cleaned, waving(90, size=0.0)).max() < 2


@pytest.mark.parametrize("joint", [WRIST, FINGERS[0]])
def test_a_jump_of_one_frame_is_a_mistake_and_a_stroke_is_none(joint):
    motion = waving(60, hertz=1.5, size=0.5)
    jumping = motion.copy()
    jumping[25, joint] += 0.2
    cleaned, wanted = (clean(clip, np.ones((60, 43)), FPS, cutoff=100.0) for clip in (jumping, motion))
    assert degrees(cleaned, wanted).max() < 5
    assert degrees(wanted[5:-5], motion[5:-5]).max() < 2


def test_what_was_never_seen_rests():
    confidence = np.ones((40, 43))
    confidence[:, FINGERS] = 0
    cleaned = clean(waving(40), confidence, FPS)
    assert np.isfinite(cleaned).all()
    assert (bone_lengths(SKELETON, cleaned) > 0.01).all()
    nothing = clean(np.full((40, 43, 3), np.nan), np.zeros((40, 43)), FPS)
    assert np.isfinite(nothing).all()
    np.testing.assert_allclose(bone_lengths(SKELETON, nothing), np.tile(SKELETON.lengths, (40, 1)), rtol=1e-4)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(count=st.integers(0, 20), seed=st.integers(0, 2**31), fraction=st.floats(0, 1), fps=st.floats(1, 120))
def test_any_gaps_give_whole_poses(count, seed, fraction, fps):
    random = np.random.default_rng(seed)
    confidence = (random.random((count, 43)) < fraction).astype(np.float32)
    motion = np.where(confidence[..., None] > 0, waving(count) + random.normal(0, 0.1, (count, 43, 3)), np.nan)
    cleaned = clean(motion, confidence, fps)
    assert cleaned.shape == (count, 43, 3)
    assert np.isfinite(cleaned).all()
    if count:
        assert np.ptp(bone_lengths(SKELETON, cleaned), axis=0).max() < 1e-5
