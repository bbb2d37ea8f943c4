"""Cues are blended into a motion: on time, without a pop, and without a touch of what they do not use."""

import functools

import numpy as np
import pytest

from ha2g_jax.motion import cues
from ha2g_jax.motion.control.parts import bones_of
from ha2g_jax.motion.cues import Cue, RunningCues, reading
from ha2g_jax.motion.cues.catalogue import GESTURES, limbs
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.rotations import about, from_vector, rotate
from ha2g_jax.skeleton import SKELETONS, load_skeleton, normalize

FPS = 15
SKELETON = load_skeleton("ted_expressive")


@functools.cache
def moving(name: str = "ted_expressive", frames: int = 54, fps: int = FPS) -> np.ndarray:
    """A motion that turns every bone a little, at its own rate."""
    skeleton = load_skeleton(name)
    rates = np.random.default_rng(0).uniform(0.2, 0.8, (skeleton.num_bones, 3))
    swing = 0.15 * np.sin(2 * np.pi * rates * np.arange(frames)[:, None, None] / fps)
    return normalize(skeleton.mean_directions + swing).astype(np.float32)


def made(*asked: Cue, motion: np.ndarray | None = None, name: str = "ted_expressive", fps: int = FPS) -> np.ndarray:
    skeleton = load_skeleton(name)
    gestures = [(cues.keyframes_of(cue, skeleton, fps), cue.time) for cue in asked]
    return cues.apply(skeleton, moving(name) if motion is None else motion, fps, gestures)


def bones(limb: str, name: str = "ted_expressive") -> list[int]:
    return bones_of(limbs(load_skeleton(name))[limb])


def speeds(motion: np.ndarray, fps: int = FPS) -> np.ndarray:
    """Radians per second (T - 1, bones)."""
    return 2 * np.arcsin(np.linalg.norm(np.diff(motion.astype(np.float64), axis=0), axis=-1) / 2) * fps


@pytest.mark.parametrize("name", SKELETONS)
def test_every_gesture_peaks_on_time_and_touches_only_its_limbs(name):
    skeleton, motion = load_skeleton(name), moving(name)
    for gesture in GESTURES:
        keys, result = cues.keyframes(skeleton, gesture), made(Cue(gesture, 1.53), name=name)
        used = [*keys.poses, *keys.turns]
        others = [bone for limb in limbs(skeleton) if limb not in used for bone in bones(limb, name)]
        np.testing.assert_array_equal(result[:, others], motion[:, others])
        at = keys.times.tolist().index(0.0)
        for limb, poses in keys.poses.items():
            np.testing.assert_allclose(result[23, bones(limb, name)], poses[at], atol=1e-5, err_msg=gesture)
        for limb, turns in keys.turns.items():
            turned = rotate(from_vector(turns[at]), motion[23, bones(limb, name)])
            np.testing.assert_allclose(result[23, bones(limb, name)], turned, atol=1e-5, err_msg=gesture)
            assert np.linalg.norm(turns, axis=1).argmax() == at
        assert speeds(result).max() < cues.MAX_SPEED + 1e-3
        is_touched = (result != motion).any(axis=(1, 2))
        assert not is_touched[:9].any() and not is_touched[48:].any()
        assert is_touched[20:28].all()


def test_gestures_have_the_shape_that_their_names_say():
    wrists, uppers, tips = {}, {}, {}
    for gesture in ("point:left", "point:right", "point:up", "point:front", "thumb", "shrug"):
        pose = SKELETON.mean_directions.copy()
        keys = cues.keyframes(SKELETON, gesture)
        for limb, poses in keys.poses.items():
            pose[bones(limb)] = poses[keys.times.tolist().index(0.0)]
        for side in ("left", "right"):
            wrists[gesture, side] = pose[SKELETON.bone(f"{side}_wrist")]
            uppers[gesture, side] = pose[SKELETON.bone(f"{side}_elbow")]
            tips[gesture, side] = pose[SKELETON.bone(f"{side}_index_3")], pose[SKELETON.bone(f"{side}_thumb_3")]
    expected = {"left": [1, 0, 0], "right": [-1, 0, 0], "up": [0, -1, 0], "front": [0, 0, -1]}
    for where, axis in expected.items():  # x is to the left, y down
        side = "left" if where == "left" else "right"
        assert wrists[f"point:{where}", side] @ axis > 0.7
        assert tips[f"point:{where}", side][0] @ axis > 0.7
        assert wrists[f"point:{where}", side] @ uppers[f"point:{where}", side] > np.cos(np.deg2rad(15))
    assert tips["thumb", "right"][1] @ [0, -1, 0] > 0.6
    fingers = [f"right_{finger}_3" for finger in ("thumb", "index", "middle", "ring", "pinky")]
    for count in range(1, 6):
        [pose] = [poses[0] for poses in cues.keyframes(SKELETON, f"count:{count}").poses.values()]
        arm = bones("right_arm")
        hand = pose[arm.index(SKELETON.bone("right_middle_1"))]
        along = [pose[arm.index(SKELETON.bone(finger))] @ hand for finger in fingers]
        assert sum(cosine > 0.7 for cosine in along) == count


def test_the_left_form_is_the_mirror_image():
    right, left = cues.keyframes(SKELETON, "count:3"), cues.keyframes(SKELETON, "count:3:left")
    mirrored = left.poses["left_arm"] * [-1, 1, 1]
    order = [bones("left_arm").index(SKELETON.mirror_bones[bone]) for bone in bones("right_arm")]
    np.testing.assert_allclose(right.poses["right_arm"], mirrored[:, order], atol=1e-6)


@pytest.mark.parametrize("cut", [1, 54])
def test_a_stream_makes_the_frames_of_a_file(cut):
    asked = (Cue("wave", 0.3), Cue("nod", 1.0), Cue("point:up", 1.9), Cue("count:2", 2.2), Cue("open", 3.5))
    running = RunningCues(SKELETON, FPS)
    for cue in asked:
        running.add(cues.keyframes(SKELETON, cue.name), cue.time)
    pieces = [running.apply(moving()[start : start + cut]) for start in range(0, 54, cut)]
    np.testing.assert_array_equal(np.concatenate(pieces), made(*asked))


def test_a_later_gesture_takes_over_its_limbs_and_leaves_the_others():
    shrug, both = made(Cue("shrug", 1.6)), made(Cue("shrug", 1.6), Cue("stop", 2.0))
    np.testing.assert_array_equal(both[:, bones("left_arm")], shrug[:, bones("left_arm")])
    np.testing.assert_array_equal(both[:, bones("head")], shrug[:, bones("head")])
    np.testing.assert_array_equal(both[30:, bones("right_arm")], made(Cue("stop", 2.0))[30:, bones("right_arm")])
    assert speeds(both).max() < cues.MAX_SPEED + 1e-3
    heads = made(Cue("nod", 1.6), Cue("shake", 1.8))[:, bones("head")]
    np.testing.assert_allclose(heads[27:], made(Cue("shake", 1.8))[27:, bones("head")], atol=1e-6)


@pytest.mark.parametrize("last", ["count:3", "point:up"])
def test_of_ten_gestures_in_a_second_the_last_is_whole(last):
    names = ("stop", "count:1", "point:right", "wave", "thumb", "count:5", "small", "stop", "open", last)
    result = made(*(Cue(name, 1.0 + index / 10) for index, name in enumerate(names)))
    assert speeds(result).max() < cues.MAX_SPEED + 1e-3
    keys = cues.keyframes(SKELETON, last)
    pose = keys.poses["right_arm"][keys.times.tolist().index(0.0)]
    np.testing.assert_allclose(result[28, bones("right_arm")], pose, atol=1e-5)
    np.testing.assert_array_equal(result[52:], moving()[52:])


def test_of_two_gestures_the_later_stroke_takes_the_limb_whichever_begins_first():
    quick, slow = Cue("stop", 1.8), Cue("point:up", 2.0)
    arm = bones("right_arm")
    np.testing.assert_allclose(made(quick, slow)[30, arm], made(slow)[30, arm], atol=1e-5)


def test_a_timed_gesture_takes_the_limb_of_one_as_soon_as_possible():
    running = RunningCues(SKELETON, FPS)
    running.add(cues.keyframes(SKELETON, "point:up"), 40 / FPS)
    before = running.apply(moving()[:30])
    running.add(cues.keyframes(SKELETON, "count:1"))
    running.add(cues.keyframes(SKELETON, "stop"), 38 / FPS)
    result = np.concatenate([before, running.apply(moving()[30:])])
    [pose] = [poses[0] for poses in cues.keyframes(SKELETON, "stop").poses.values()]
    np.testing.assert_allclose(result[38, bones("right_arm")], pose, atol=1e-5)


@pytest.mark.parametrize("time", [None, 0.2, 1.4])
def test_a_gesture_that_is_late_is_made_as_soon_as_possible(time):
    running = RunningCues(SKELETON, FPS)
    before = running.apply(moving()[:20])
    running.add(cues.keyframes(SKELETON, "count:3"), time)
    result = np.concatenate([before, running.apply(moving()[20:])])
    [pose] = [poses[0] for poses in cues.keyframes(SKELETON, "count:3").poses.values()]
    way = np.linalg.norm(result[:, bones("right_arm")] - pose, axis=-1).max(axis=1)
    assert 26 <= way.argmin() <= 31 and way.min() < 1e-5
    assert speeds(result).max() < cues.MAX_SPEED + 1e-3


def test_at_the_borders_of_a_file_a_gesture_is_cut():
    """It is under way in the first frame, and ends with the last one; after another motion it begins from that."""
    whole = made(Cue("count:3", 1.0))
    np.testing.assert_array_equal(whole[:20], made(Cue("count:3", 1.0), motion=moving()[:20]))
    early = made(Cue("count:3", 0.2))
    [pose] = [poses[0] for poses in cues.keyframes(SKELETON, "count:3").poses.values()]
    np.testing.assert_allclose(early[3, bones("right_arm")], pose, atol=1e-5)
    after = cues.apply(SKELETON, moving(), FPS, [(cues.keyframes(SKELETON, "count:3"), 0.2)], before=moving()[0])
    assert speeds(np.concatenate([moving()[:1], after])).max() < cues.MAX_SPEED + 1e-3


def test_a_clip_is_shown_whole_with_its_middle_at_its_time(tmp_path):
    clip = made(Cue("wave", 1.0), motion=moving(frames=30))
    Motion.from_directions(SKELETON, clip, FPS).save(tmp_path / "wave.npz")
    result = made(reading.read_clip(Cue(f"clip:{tmp_path / 'wave.npz'}", 2.0), SKELETON))
    np.testing.assert_allclose(result[15:45], clip, atol=1e-4)
    np.testing.assert_array_equal(result[:9], moving()[:9])
    np.testing.assert_array_equal(result[52:], moving()[52:])


def test_a_hand_that_turns_over_goes_one_way():
    """Where the way is as far on either side, it is kept from frame to frame."""
    arm, hand = bones("right_arm"), bones("right_arm")[2:]
    base = np.repeat(moving()[:1], 40, 0)
    base[:, arm] = cues.keyframes(SKELETON, "count:5").poses["right_arm"][0]
    forearm = base[0, arm[1]].astype(np.float64)
    for number, frame in enumerate(base):
        frame[hand] = rotate(about(forearm, np.pi + 0.05 * (-1) ** number), frame[hand])
    result = made(Cue("count:5", 2.0), motion=base)
    [middle] = [bone for bone in hand if bone == SKELETON.bone("right_middle_1")]
    turned = np.cumsum(speeds(result)[:30, middle] / FPS)[-1]
    palm = np.cross(result[:, SKELETON.bone("right_index_1")], result[:, SKELETON.bone("right_pinky_1")])
    side = palm[18:31] @ np.cross(forearm, palm[30])
    assert turned < 2 and (side.min() > -0.05 or side.max() < 0.05)
