"""The teacher: every movement has the cause that it claims, and the body stays a body."""

import numpy as np
import pytest

from ha2g_jax import anatomy
from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.talk import speakers, strokes, teacher
from ha2g_jax.data.talk.stances import STANCES
from ha2g_jax.features.text import Word
from ha2g_jax.metrics import hands
from ha2g_jax.metrics.beats.strokes import match, recall, stroke_beats

SKELETON = skeletons.load_skeleton(teacher.SKELETON)
SECONDS = 10
SYLLABLES = np.array([1.0, 1.7, 2.6, 4.4, 5.1, 5.9, 7.5, 8.4])
WORDS = (Word("everything", 2.0, 2.4), Word("table", 4.0, 4.3), Word("tiny", 6.5, 6.9))


def speech(loudness: float = 0.3, syllables: np.ndarray = SYLLABLES) -> np.ndarray:
    """A hum of 140 Hz with rich overtones whose loudness peaks at `syllables`, over a little noise."""
    times = np.arange(SECONDS * strokes.SAMPLE_RATE) / strokes.SAMPLE_RATE
    hum = sum(np.sin(2 * np.pi * 140 * harmonic * times) / harmonic for harmonic in range(1, 20))
    peaks = np.exp(-((times[:, None] - syllables) ** 2) / (2 * 0.06**2)).sum(axis=1)
    noise = np.random.default_rng(0).standard_normal(len(times))
    return (loudness * (0.3 * hum * peaks + 1e-3 * noise)).astype(np.float32)


def perform(audio=None, words=WORDS, who=speakers.Style(handedness=0.8), seed=0):  # noqa: B008
    audio = speech() if audio is None else audio
    return teacher.perform(audio, words, who, np.random.default_rng(seed))


def directions(movement: teacher.Movement) -> np.ndarray:
    return skeletons.positions_to_directions(SKELETON, movement.positions)


def wrist_speed(movement: teacher.Movement) -> np.ndarray:
    wrist = movement.positions[:, SKELETON.joint("right_wrist")]
    return np.linalg.norm(np.gradient(wrist, axis=0), axis=-1) * 15


def test_same_seed_same_bytes_and_frames_as_long_as_the_audio():
    first, second, other = perform(), perform(), perform(seed=1)
    assert first.positions.tobytes() == second.positions.tobytes()
    assert first.strokes == second.strokes
    assert first.positions.shape == (SECONDS * 15, 43, 3)
    assert first.positions.dtype == np.float32
    wrists = [SKELETON.joint("left_wrist"), SKELETON.joint("right_wrist")]
    apart = np.linalg.norm(first.positions[:, wrists] - other.positions[:, wrists], axis=-1)
    assert apart.mean() > 0.1  # stances are drawn


def test_bones_keep_their_lengths():
    lengths = skeletons.bone_lengths(SKELETON, perform().positions)
    np.testing.assert_allclose(lengths, np.broadcast_to(SKELETON.lengths, lengths.shape), atol=1e-5)


def test_hands_rest_in_a_long_pause():
    movement = perform(speech(syllables=SYLLABLES[[0, 1, 2, 7]]), words=())
    speed = wrist_speed(movement)
    assert speed[15:40].max() > 0.5
    assert speed[63:110].max() < 0.1
    wrists = movement.positions[63:110, [SKELETON.joint("left_wrist"), SKELETON.joint("right_wrist")], 1]
    assert wrists.min() > movement.positions[:, SKELETON.joint("neck"), 1].max() + 0.5  # the arms hang


def test_angles_stay_within_anatomical_limits():
    lively = speakers.Style(amplitude=1, mixing=1, handedness=1, elbow=1)
    unit = directions(perform(who=lively))
    for side in ("left", "right"):
        upper, fore, hand = (unit[:, SKELETON.bone(f"{side}_{child}")] for child in ("elbow", "wrist", "middle_1"))
        elbow = np.rad2deg(np.arccos(np.sum(upper * fore, axis=-1)))
        wrist = np.rad2deg(np.arccos(np.clip(np.sum(fore * hand, axis=-1), -1, 1)))
        assert elbow.min() > anatomy.ARM_LIMITS["elbow"][0] - 1
        assert elbow.max() < anatomy.ARM_LIMITS["elbow"][1] + 1
        assert wrist.max() < anatomy.ARM_LIMITS["extension"][1] + 6
    flexions = anatomy.finger_flexions(SKELETON, unit)
    assert flexions.min() > -0.01
    assert flexions.max() < 1.01


def test_beats_fall_on_syllables_and_can_be_seen_there():
    met = []
    for seed in range(4):
        movement = perform(words=(), seed=seed)
        times = [stroke.time for stroke in movement.strokes if stroke.kind == "beat"]
        np.testing.assert_allclose(times, SYLLABLES, atol=0.06)
        wrists = movement.positions[:, [SKELETON.joint("left_wrist"), SKELETON.joint("right_wrist")]]
        met.append(recall(np.array([match(np.array(times), np.array(times), stroke_beats(wrists, 15))])))
    assert np.mean(met) > 0.9


def test_stances_are_taken_at_syllables_and_left_for_rest():
    movement = perform(words=())
    stances = [stroke for stroke in movement.strokes if stroke.kind == "stance"]
    assert [stroke.time for stroke in stances] == sorted(stroke.time for stroke in stances)
    *spoken, last = stances
    assert last.word_class == "rest"
    assert last.time > SYLLABLES[-1] + 1
    np.testing.assert_allclose([stroke.time for stroke in spoken if stroke.word_class != "rest"], SYLLABLES, atol=0.06)
    new = [stroke.word_class for stroke in spoken if stroke.amplitude == 1]
    assert set(new) <= {*STANCES, "rest"}
    assert len(set(new)) > 1


@pytest.mark.parametrize("seed", range(6))
def test_body_is_a_body(seed):
    """Hands pass neither through the trunk nor the face nor each other, and nothing jumps, in any style."""
    positions = perform(who=speakers.sample_style(np.random.default_rng(seed)), seed=seed).positions.astype(float)
    joint = {name: positions[:, SKELETON.joint(name)] for name in SKELETON.joints}
    joints = positions[:, skeletons.hand_joints(SKELETON)]
    head = (joint["left_ear"] + joint["right_ear"]) / 2
    assert np.linalg.norm(joints - head[:, None], axis=-1).min() > 0.11
    along = np.clip(joints[..., 1] / joint["neck"][:, None, 1], 0, 1)
    offset = joints - along[..., None] * joint["neck"][:, None]
    inside = (offset[..., 0] / 0.15) ** 2 + (offset[..., 2] / 0.09) ** 2 < 1
    assert not (inside & (joints[..., 1] > joint["neck"][:, None, 1]) & (joints[..., 1] < 0.2)).any()
    assert np.linalg.norm(joint["left_wrist"] - joint["right_wrist"], axis=-1).min() > 0.06
    assert np.linalg.norm(np.diff(positions, axis=0), axis=-1).max() * 15 < 9


def test_hands_have_the_space_of_a_person():
    """Both hands move most of the time, far to the sides, and takes of one style are in different places."""
    audio = speech(syllables=np.arange(0.5, 9.5, 0.3))
    takes = [perform(audio, (), seed=seed).positions for seed in range(4)]
    body = hands.upper_body(SKELETON, np.concatenate(takes), 15.0)
    assert hands.slower_wrist(body) > 0.25
    assert hands.both_moving(body) > 0.5
    assert hands.lateral_spread(body) > 9
    assert 55 < hands.hand_distances(body).mean() < 85
    assert 3 < hands.head_deviation(body) < 8
    wrists = np.stack(takes)[:, :, [SKELETON.joint("left_wrist"), SKELETON.joint("right_wrist")]]
    assert np.linalg.norm(wrists[0] - wrists[1:], axis=-1).mean() > 0.1


def test_speech_of_varied_loudness_moves_more():
    syllables = np.arange(0.5, 9.5, 0.3)
    peaks = np.random.default_rng(0).choice([0.15, 1.0], len(syllables))
    varied = speech(syllables=syllables) * np.interp(np.arange(SECONDS * 16000) / 16000, syllables, peaks)
    takes = [
        [perform(audio.astype(np.float32), (), seed=seed).positions for seed in range(4)]
        for audio in (speech(syllables=syllables), varied)
    ]
    flat, lively = (hands.upper_body(SKELETON, np.concatenate(each), 15.0) for each in takes)
    assert hands.slower_wrist(lively) > 1.1 * hands.slower_wrist(flat)


@pytest.mark.parametrize("curl", [-1, 1])
def test_relaxed_fingers_are_side_by_side(curl):
    unit = directions(perform(words=(), who=speakers.Style(curl=curl)))
    index, little = (unit[:, SKELETON.bone(f"left_{name}_2")] for name in ("index", "pinky"))
    spread = np.rad2deg(np.arccos(np.sum(index * little, axis=-1)))
    assert 8 < spread.mean() < 20


def test_louder_syllables_make_larger_beats():
    audio = speech() * np.where(np.arange(SECONDS * strokes.SAMPLE_RATE) < 3.5 * strokes.SAMPLE_RATE, 0.5, 1.0)
    beats = [stroke for stroke in perform(audio.astype(np.float32), ()).strokes if stroke.kind == "beat"]
    quiet, loud = ([beat.amplitude for beat in beats if (beat.time < 3.5) == early] for early in (True, False))
    assert max(quiet) < min(loud)


def test_beats_do_not_depend_on_the_words():
    def of_sound(movement):
        return [stroke for stroke in movement.strokes if stroke.kind != "semantic"]

    assert of_sound(perform(words=())) == of_sound(perform())


@pytest.mark.parametrize("handedness", [0.8, -0.8])
def test_hand_takes_the_shape_of_the_word(handedness):
    movement = perform(who=speakers.Style(handedness=handedness))
    flexions = anatomy.finger_flexions(SKELETON, directions(movement))[:, int(handedness > 0)]
    strokes = [stroke for stroke in movement.strokes if stroke.kind == "semantic"]
    assert [stroke.word_class for stroke in strokes] == ["open", "small"]
    for stroke in strokes:
        held = flexions[round(stroke.time * 15) : round((stroke.time + 0.4) * 15)]
        shapes = np.array(list(anatomy.HAND_SHAPES.values()))
        nearest = np.linalg.norm(held[:, None] - shapes[None], axis=-1).argmin(axis=-1)
        assert {list(anatomy.HAND_SHAPES)[index] for index in nearest} == {stroke.word_class}


def test_fingers_do_not_follow_the_sound():
    loud, silent = perform(), perform(np.zeros(SECONDS * strokes.SAMPLE_RATE, np.float32))
    first, second = (anatomy.finger_flexions(SKELETON, directions(movement)) for movement in (loud, silent))
    np.testing.assert_allclose(first, second, atol=2e-3)


def test_recording_level_does_not_matter():
    loud, soft = perform(), perform(speech(0.03))
    np.testing.assert_allclose(loud.positions, soft.positions, atol=1e-3)


def test_silence_rests():
    movement = perform(np.zeros(3 * strokes.SAMPLE_RATE, np.float32), ())
    assert movement.strokes == ()
    spine, wrist = (movement.positions[:, SKELETON.joint(name), 1] for name in ("spine", "right_wrist"))
    assert (wrist > spine + 0.2).all()  # from the first frame on
    assert np.isfinite(movement.positions).all()
    assert wrist_speed(movement).max() < 0.1


def test_style_changes_size_and_side():
    def activity(**fields):
        takes = [perform(words=(), who=speakers.Style(**fields), seed=seed).positions for seed in range(4)]
        wrists = np.stack(takes)[:, :, [SKELETON.joint("left_wrist"), SKELETON.joint("right_wrist")]]
        return np.linalg.norm(np.diff(wrists, axis=1), axis=-1).mean(axis=(0, 1))

    assert activity(amplitude=1).sum() > 1.5 * activity(amplitude=-1).sum()
    left, right = activity(handedness=1)
    assert right > 1.1 * left
    left, right = activity(handedness=-1)
    assert left > 1.1 * right


def test_styles_stay_in_the_cube():
    sampled = np.array([speakers.sample_style(np.random.default_rng(seed)) for seed in range(50)])
    assert np.abs(sampled).max() <= 1
    assert np.abs(sampled[:, speakers.Style._fields.index("handedness")]).min() > 0.25


def test_animates_a_real_recording(private_data):
    import soundfile

    audio, _ = soundfile.read(next((private_data / "zeroeggs_067").glob("*.wav")), dtype="float32")
    movement = perform(audio, ())
    beats = sum(stroke.kind == "beat" for stroke in movement.strokes)
    assert 20 < beats / (len(audio) / strokes.SAMPLE_RATE / 60) < 90
    assert np.median(wrist_speed(movement)) < 0.4
