"""What augmentation changes is what it says, by the amount it says, in every array that must agree."""

from typing import Any

import numpy as np
import pytest

from ha2g_jax.data.augment import (
    Augmentation,
    add_noise,
    augment,
    equalize,
    hide_end,
    make_quieter,
    mirror_example,
    reverberate,
    warp_formants,
)
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.spectrum import FLOOR_DB, HIDDEN_DB, heard_columns, log_mel, mel_window, sound_power
from ha2g_jax.features.text import PADDING
from ha2g_jax.skeleton import directions_to_positions, joint_angles, load_skeleton, normalize

SKELETON = load_skeleton("ted_expressive")
NUM_SPEAKERS = 3
FPS = 15


@pytest.fixture
def example() -> dict[str, Any]:
    rng = np.random.default_rng(0)
    directions = SKELETON.mean_directions + rng.normal(0, 0.2, (34, SKELETON.num_bones, 3))
    return {
        "mel": rng.uniform(-60, 0, (128, 70)).astype(np.float32),
        "words": rng.integers(0, 9, 34).astype(np.int32),
        "directions": normalize(directions.astype(np.float32)),
        "speaker": np.int32(2),
        "images": rng.integers(0, 256, (4, 8, 8, 3)).astype(np.uint8),
    }


def test_mirror_changes_pose_images_and_speaker_together(example):
    mirrored = mirror_example(example, SKELETON, NUM_SPEAKERS)
    left, right = SKELETON.joint("left_wrist"), SKELETON.joint("right_wrist")
    before, after = (directions_to_positions(SKELETON, e["directions"]) for e in (example, mirrored))
    # The two sides differ in their mean bone lengths by a few millimetres.
    np.testing.assert_allclose(after[:, left], before[:, right] * (-1, 1, 1), atol=0.02)
    np.testing.assert_array_equal(mirrored["images"][:, :, 0], example["images"][:, :, -1])
    assert mirrored["speaker"].dtype == np.int32
    assert mirrored["speaker"] == 2 + NUM_SPEAKERS
    for name in ("mel", "words"):
        assert mirrored[name] is example[name]


def test_mirror_twice_is_the_example(example):
    twice = mirror_example(mirror_example(example, SKELETON, NUM_SPEAKERS), SKELETON, -NUM_SPEAKERS)
    for name, array in example.items():
        np.testing.assert_array_equal(twice[name], array)


def _other_side(skeleton) -> tuple[list[int], np.ndarray]:
    """For each angle the number of that on the other side, and whether it is one with a palm normal."""
    bones = [*skeleton.mirror_bones.tolist(), *(skeleton.num_bones + palm for palm in (1, 0))]
    pairs = [frozenset(pair) for pair in skeleton.angle_pairs]
    partners = [pairs.index(frozenset(bones[bone] for bone in pair)) for pair in skeleton.angle_pairs]
    return partners, np.array([max(pair) >= skeleton.num_bones for pair in skeleton.angle_pairs])


@pytest.mark.parametrize("name", ["ted_expressive", "ted_gesture"])
def test_joint_angles_in_a_mirror_are_those_of_the_other_side(name):
    """Except for palm normals: a mirror reverses a cross product, so that their angles become pi minus them."""
    skeleton = load_skeleton(name)
    rng = np.random.default_rng(0)
    directions = normalize(rng.normal(size=(20, skeleton.num_bones, 3)))
    pose = {"directions": directions, "speaker": np.int32(0)}
    angles = joint_angles(skeleton, directions)
    mirrored = joint_angles(skeleton, mirror_example(pose, skeleton, 1)["directions"])
    partners, has_palm = _other_side(skeleton)
    swapped = angles[:, partners]
    np.testing.assert_allclose(mirrored, np.where(has_palm, np.pi - swapped, swapped), atol=1e-6)


def test_a_mirror_keeps_to_the_angle_statistics_of_people():
    """Eq. 8 expects of a mirrored pose what it expects of a pose: the means of both sides are near each other."""
    partners, has_palm = _other_side(SKELETON)
    assert has_palm.sum() == 2
    other = SKELETON.angle_mean[partners]
    np.testing.assert_allclose(SKELETON.angle_mean, np.where(has_palm, 1 - other, other), atol=0.07)


def test_quieter_speech(example):
    quieter = make_quieter(example["mel"], 30)
    np.testing.assert_allclose(quieter, np.maximum(example["mel"] - 30, FLOOR_DB), atol=1e-5)
    assert quieter.dtype == np.float32 and quieter.min() == FLOOR_DB
    np.testing.assert_array_equal(make_quieter(example["mel"], 0), example["mel"])


@pytest.mark.parametrize("snr_db", [0.0, 10.0, 40.0])
def test_noise_has_the_power_asked_for(snr_db):
    """Speech far below the noise in most bins, so that what was added can be measured."""
    mel = np.full((128, 70), FLOOR_DB, np.float32)
    mel[10:14, 20:40] = -3
    speech = np.power(10.0, mel / 10)
    noisy = add_noise(mel, sound_power(speech) / 10 ** (snr_db / 10), np.random.default_rng(0))
    both = np.power(10.0, noisy / 10)
    measured = 10 * np.log10(sound_power(speech) / sound_power(both - speech))
    assert abs(measured - snr_db) < 0.5
    assert noisy.dtype == np.float32 and noisy.max() <= 0


def test_noise_is_that_of_a_waveform():
    """The mean spectrogram is that of real white noise added to the samples at the same ratio."""
    rng = np.random.default_rng(0)
    time = np.arange(70 * 512) / SAMPLE_RATE
    harmonics = [np.sin(2 * np.pi * 131 * k * time + k**2) / k for k in range(1, 30)]
    speech = np.stack(harmonics).sum(axis=0).astype(np.float32)
    noise = rng.normal(size=len(speech)).astype(np.float32)
    noise *= np.sqrt(np.mean(speech**2) / np.mean(noise**2) / 10)  # 10 dB
    reference = 1e5  # so that nothing is cut at 0 dB
    clean, real = log_mel(speech, reference)[:, :70], log_mel(speech + noise, reference)[:, :70]
    noisy = add_noise(clean, sound_power(np.power(10, clean / 10)) / 10, rng)
    difference = 10 * np.log10(np.power(10, noisy / 10).mean(axis=1) / np.power(10, real / 10).mean(axis=1))
    assert abs(difference.mean()) < 0.5
    assert np.abs(difference).max() < 3


@pytest.mark.parametrize("factor", [0.85, 1.0, 1.2])
def test_formants_move_by_the_factor_of_the_vocal_tract(factor):
    """The spectrogram of a tone becomes that of a tone of `factor` times its frequency, to a band."""

    def tone(frequency: float) -> np.ndarray:
        return log_mel(np.sin(2 * np.pi * frequency * np.arange(20 * 512) / SAMPLE_RATE).astype(np.float32))

    for frequency in (300.0, 1200.0, 3000.0):
        warped = warp_formants(tone(frequency), factor)
        assert np.all(np.abs(warped.argmax(axis=0)[2:-2] - tone(factor * frequency).argmax(axis=0)[2:-2]) <= 1)
    assert warped.dtype == np.float32
    slope = np.repeat(np.linspace(-60, 0, 128, dtype=np.float32)[:, None], 3, axis=1)
    np.testing.assert_allclose(warp_formants(slope, factor)[[0, -1]], slope[[0, -1]], atol=0.5)  # the ends stay
    if factor == 1:
        np.testing.assert_allclose(warp_formants(slope, factor), slope, atol=1e-4)


def test_an_equalizer_changes_all_columns_alike():
    """Its response is smooth over the bands, as large as asked for and nowhere above 0 dB."""
    mel = np.random.default_rng(0).uniform(-40, 0, (128, 70)).astype(np.float32)
    response = equalize(mel, 10.0, np.random.default_rng(1)) - mel
    assert response.dtype == np.float32
    np.testing.assert_allclose(response, response[:, :1].repeat(70, axis=1), atol=1e-5)
    assert response.max() == pytest.approx(0, abs=1e-5) and -20 < response.min() < -3
    assert np.abs(np.diff(response[:, 0])).max() < 1


def test_reverberation_falls_by_60_db_in_its_time():
    """The tail of a click, and its power, that of the click less the ratio that was asked for."""
    mel = np.full((4, 70), FLOOR_DB, np.float32)
    mel[:, 10] = 0
    heard = reverberate(mel, 1.0, 3.0)
    np.testing.assert_allclose(np.diff(heard[:, 11:30]), -60 * 512 / SAMPLE_RATE, atol=0.01)
    np.testing.assert_allclose(heard[:, :11], mel[:, :11], atol=2)  # the floor reverberates too
    assert 10 * np.log10(np.power(10, heard[0, 11:] / 10).sum()) == pytest.approx(-3, abs=0.1)


def test_silence_stays_silence():
    silence = np.full((128, 70), FLOOR_DB, np.float32)
    np.testing.assert_array_equal(equalize(silence, 10.0, np.random.default_rng(0)), silence)
    np.testing.assert_allclose(reverberate(silence, 0.5, 15.0), silence, atol=0.2)


def test_noise_is_as_loud_in_a_pause(example):
    """A window of silence gets the noise of its clip, not one relative to its own sound."""
    pause = example | {"mel": np.full((128, 70), FLOOR_DB, np.float32)}
    noisy = _augmented(pause, Augmentation(noise=1.0, noise_snr_db=(20.0, 20.0)), seed=0, clip_power=0.1)
    measured = 10 * np.log10(sound_power(np.power(10.0, noisy["mel"] / 10)))
    assert abs(measured - (-10 - 20)) < 0.5


def _augmented(example, settings: Augmentation, seed: int, clip_power: float = 0.1) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    return augment(example, settings, SKELETON, NUM_SPEAKERS, rng, clip_power=clip_power, start_frame=0, fps=FPS)


def _num_hidden(mel: np.ndarray) -> int:
    """The number of hidden columns, which are all at the end."""
    is_hidden = (mel == HIDDEN_DB).all(axis=0)
    count = int(is_hidden.sum())
    assert is_hidden[len(is_hidden) - count :].all()
    return count


@pytest.mark.parametrize("fps", [15, 24])
@pytest.mark.parametrize("start_frame", [1, 7, 24])  # the first column of a clip needs no sample
def test_hidden_columns_are_those_that_need_later_samples(start_frame, fps):
    """Other samples after the heard frames, at a fixed 0 dB, change hidden columns only, and each of these."""
    rng = np.random.default_rng(0)
    speech = rng.normal(0, 0.1, 5 * SAMPLE_RATE).astype(np.float32)
    before = mel_window(log_mel(speech, 100.0), start_frame, 34, fps)
    for heard in (0, 4, 5, 20, 33, 34):
        end = (start_frame + heard) * SAMPLE_RATE // fps
        other = np.concatenate([speech[:end], rng.normal(0, 0.1, len(speech) - end).astype(np.float32)])
        after = mel_window(log_mel(other, 100.0), start_frame, 34, fps)
        example = {"mel": before, "words": np.arange(34, dtype=np.int32)}
        hidden = hide_end(example, start_frame, heard, fps)
        np.testing.assert_array_equal((hidden["mel"] == HIDDEN_DB).all(axis=0), (before != after).any(axis=0))
        count = before.shape[1] - _num_hidden(hidden["mel"])
        np.testing.assert_array_equal(hidden["mel"][:, :count], before[:, :count])
        np.testing.assert_array_equal(hidden["words"], [*range(heard), *[PADDING] * (34 - heard)])
    np.testing.assert_array_equal(example["words"], np.arange(34))


def test_the_heard_part_has_every_length(example):
    settings = Augmentation(lookahead=1.0, least_heard=4)
    lengths = {70 - _num_hidden(_augmented(example, settings, seed)["mel"]) for seed in range(400)}
    assert lengths == {heard_columns(heard, FPS) for heard in range(4, 34)}


def test_a_fraction_of_the_ends_is_hidden(example):
    settings = Augmentation(lookahead=0.3)
    hidden = [_num_hidden(_augmented(example, settings, seed)["mel"]) > 0 for seed in range(300)]
    assert 0.2 < np.mean(hidden) < 0.4


def test_a_hidden_end_leaves_the_other_changes_as_they_are(example):
    """Noise and gain do not reach the hidden columns, and they are the same in the others, hidden end or not."""
    settings = Augmentation(mirror=0.5, gain_db=6.0, noise=0.5)
    for seed in range(20):
        expected = _augmented(example, settings, seed)
        found = _augmented(example, settings._replace(lookahead=1.0), seed)
        count = 70 - _num_hidden(found["mel"])
        assert count < 70
        np.testing.assert_array_equal(found["mel"][:, :count], expected["mel"][:, :count])
        for name in ("directions", "speaker", "images"):
            np.testing.assert_array_equal(found[name], expected[name])


def test_random_numbers_decide_all(example):
    settings = Augmentation(mirror=0.5, equalizer_db=6.0, reverb=0.5, gain_db=6.0, noise=0.5, lookahead=0.5)

    def draw(seed):
        return _augmented(example, settings, seed)

    for name, array in draw(0).items():
        np.testing.assert_array_equal(array, draw(0)[name])
    mirrored = [draw(seed)["speaker"] >= NUM_SPEAKERS for seed in range(40)]
    assert 8 < sum(mirrored) < 32
    assert len({draw(seed)["mel"].tobytes() for seed in range(40)}) == 40


def test_each_setting_alone(example):
    """A probability of 1 changes every example, and only the arrays that it is about."""
    changes = {
        "mirror": ({"mirror": 1.0}, {"directions", "speaker", "images"}),
        "equalizer": ({"equalizer_db": 6.0}, {"mel"}),
        "reverb": ({"reverb": 1.0}, {"mel"}),
        "gain": ({"gain_db": 20.0}, {"mel"}),
        "noise": ({"noise": 1.0, "noise_snr_db": (0.0, 5.0)}, {"mel"}),
        "lookahead": ({"lookahead": 1.0}, {"mel", "words"}),
        "nothing": ({"jitter": 3, "least_heard": 4}, set()),
    }
    before = {name: array.copy() for name, array in example.items()}
    for settings, expected in changes.values():
        after = _augmented(example, Augmentation(**settings), 0)
        assert {name for name in example if not np.array_equal(after[name], before[name])} == expected
    for name, array in before.items():
        np.testing.assert_array_equal(example[name], array)
