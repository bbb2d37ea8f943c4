"""The frames of a stream are those of a file, and no frame is made from a sample that it may not know."""

import dataclasses

import numpy as np
import pytest
from fixtures.streams import speech, streamed

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.noise import track
from ha2g_jax.features.spectrum import FLOOR_DB, hide_unheard, mel_power
from ha2g_jax.motion.windows import window_stride
from ha2g_jax.skeleton import normalize
from ha2g_jax.synthesis import Style, running_generator, running_motion, stream

FPS = 15


@pytest.mark.parametrize("seconds", [0.2, 2.2667, 2.32, 4.2667, 9.03])
def test_long_hops_give_the_frames_of_a_file(debug_model, seconds):
    """A file begins with the M frames of its seed pose, here 3, a fifth of a second; a stream goes on from them."""
    spec, assets = debug_model.spec, debug_model.assets
    spec = spec._replace(num_seed_frames=3, generator=spec.generator.clone(num_seed_frames=3))
    assets = dataclasses.replace(assets, seed_poses=assets.seed_poses[:, :3])
    model, samples = dataclasses.replace(debug_model, spec=spec, assets=assets), speech(seconds, 1)
    long = {"look_ahead": 34, "hop": window_stride(34, 3), "reference": float(mel_power(samples).max())}
    expected = model.generate(np.pad(samples, (SAMPLE_RATE // 5, 0)), seed=3, style=Style(speaker="ada"))
    found = streamed(model, samples, 1000, seed=3, style=Style(speaker="ada"), **long)
    np.testing.assert_allclose(found, expected.directions[3:], atol=1e-4)


@pytest.mark.parametrize(("has_hidden_ends", "first"), [(False, 25), (True, 4)])
def test_a_moment_has_the_same_noise_each_time_it_is_sampled(sampling_model, has_hidden_ends, first, monkeypatch):
    """That of the number of its frame: a window may begin before the speech, and the next one two frames later."""
    generate, seen = running_generator.generate_window, []
    monkeypatch.setattr(running_generator, "generate_window", lambda *args: seen.append(args[-1]) or generate(*args))
    parts = sampling_model.spec, sampling_model.variables, sampling_model.assets
    live = stream.Stream(*parts, seed=5, has_hidden_ends=has_hidden_ends)
    del seen[:]  # those of the pose at rest
    live.feed(speech(2))
    assert len(seen) > 8 and seen[0].shape == (34, 32)
    whole = track(5, np.arange(-first, 100), FPS, 32)
    for run, noise in enumerate(seen):
        np.testing.assert_array_equal(noise, whole[2 * run : 2 * run + 34])


@pytest.mark.parametrize(("samples", "hop", "stays"), [(True, 2, True), (True, 1, False), (False, 2, False)])
def test_windows_that_exaggerate_do_not_carry_the_hands_away(sampling_model, samples, hop, stays, monkeypatch):
    """Each window goes on a tenth farther from the mean pose than its seed pose; in silence it rests elsewhere."""
    spec, assets = sampling_model.spec, sampling_model.assets
    mean = spec.skeleton.mean_directions

    def exaggerate(spec, variables, sound, style, seed_pose, noise):
        is_silent = sound["mel"].max() <= FLOOR_DB
        pose = normalize(-mean if is_silent else mean + 1.1 * (seed_pose[-1] - mean))
        return np.broadcast_to(pose, (spec.num_frames, *pose.shape))

    monkeypatch.setattr(running_generator, "generate_window", exaggerate)
    spec = spec if samples else spec._replace(noise_dim=0)
    live = stream.Stream(spec, sampling_model.variables, assets, hop=hop, has_hidden_ends=True)
    distances = np.linalg.norm(live.feed(speech(10)) - normalize(mean), axis=(1, 2))
    assert (distances[-1] < distances[0]) == stays


def test_windows_that_come_to_rest_by_and_by_do(sampling_model, monkeypatch):
    """Each window goes three quarters as far from the pose at rest as its seed pose, as those of the demo in noise."""
    spec, variables, assets = sampling_model.spec, sampling_model.variables, sampling_model.assets
    rest = normalize(-spec.skeleton.mean_directions + 0.5)

    def calm(spec, variables, sound, style, seed_pose, noise):
        is_silent = sound["mel"].max() <= FLOOR_DB
        pose = normalize(rest + (0 if is_silent else 0.75) * (seed_pose[-1] - rest))
        return np.broadcast_to(pose, (spec.num_frames, *pose.shape))

    monkeypatch.setattr(running_generator, "generate_window", calm)
    live = stream.Stream(spec, variables, assets, has_hidden_ends=True)
    distances = np.linalg.norm(live.feed(speech(10)) - rest, axis=(1, 2))
    assert distances[-1] < 0.01 * distances[0]


@pytest.mark.parametrize("is_trained", [False, True])
@pytest.mark.parametrize(("look_ahead", "hop"), [(0, 1), (3, 1), (3, 4), (8, 2), (0, 26)])
def test_no_sample_after_the_look_ahead_changes_a_frame(debug_model, trained_model, look_ahead, hop, is_trained):
    """To the bit, with 0 dB as it runs; and the next sample heard does change the next frames."""
    debug_model, samples = trained_model if is_trained else debug_model, speech(3)
    before = streamed(debug_model, samples, look_ahead=look_ahead, hop=hop)
    for runs in (1, 2, 5) if hop < 26 else (1,):
        frames = runs * hop
        heard = (frames - 1 + look_ahead) * SAMPLE_RATE // FPS
        other = np.concatenate([samples[:heard], speech(3, seed=9, level=0.3)[heard:]])
        after = streamed(debug_model, other, look_ahead=look_ahead, hop=hop)
        np.testing.assert_array_equal(after[:frames], before[:frames])
        assert not np.array_equal(after[frames : frames + 3], before[frames : frames + 3])


@pytest.mark.parametrize("look_ahead", [1, 3, 15, 30])
def test_only_a_model_that_was_trained_for_it_meets_hidden_ends(debug_model, trained_model, look_ahead, monkeypatch):
    hidden = []

    def record(mel, start, heard, fps):
        result = hide_unheard(mel, start, heard, fps)
        hidden.append(int((result != mel).any(axis=0).sum()))
        return result

    monkeypatch.setattr(running_motion, "hide_unheard", record)
    debug_model.stream(look_ahead=look_ahead).feed(speech(3))
    assert hidden and not any(hidden)
    hidden.clear()
    trained_model.stream(look_ahead=look_ahead).feed(speech(3))
    assert all(hidden) == (look_ahead < 30)
