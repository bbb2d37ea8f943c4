"""Windows of any whole frame rate and length give features on their frames; other sizes are refused by name."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.config import presets
from ha2g_jax.data.speech import prepare, window
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.layers.resnet_se import AudioEncoder
from ha2g_jax.layers.waveform import WaveformEncoder
from ha2g_jax.methods import build, method_of
from ha2g_jax.methods.method import example_batch, subtract_mean
from ha2g_jax.skeleton import load_skeleton

GENERATING = ("ha2g", "seq2seq", "speech2gesture", "joint_embedding", "trimodal")
SIZES = [(20, 17), (30, 68)]  # beside those of the presets


def make(method="ha2g", fps=15, num_frames=34, **changes):
    changes = {"data.fps": fps, "data.num_frames": num_frames} | changes
    config = presets.make("ted_gesture", "debug", method, changes)
    return build(config, load_skeleton("ted_gesture"), 11, 5)


@pytest.mark.parametrize(("fps", "num_frames"), SIZES)
@pytest.mark.parametrize("method", [*presets.METHODS, "whisper"])
def test_a_generator_of_any_window_gives_its_frames(method, fps, num_frames):
    if method == "whisper":
        spec = make("ha2g", fps, num_frames, **{"model.audio.kind": "whisper"})
    else:
        spec = make(method, fps, num_frames)
    arguments = method_of(spec).init_arguments(spec, example_batch(spec))
    poses, _ = jax.eval_shape(
        lambda key: spec.generator.init_with_output(key, *arguments, train=False), jax.random.key(0)
    )
    assert jax.tree.leaves(poses)[-1].shape == (1, num_frames, 27)


def test_poses_of_float64_are_float32_as_networks_take_them():
    spec = make()
    with jax.enable_x64(True):
        assert subtract_mean(spec, jnp.zeros((2, 34, spec.skeleton.num_bones, 3), jnp.float64)).dtype == jnp.float32


@pytest.mark.parametrize("method", GENERATING)
@pytest.mark.parametrize(("fps", "num_frames"), [*SIZES, (25, 34)])
def test_windows_are_cut_as_long_as_the_networks_take_them(method, fps, num_frames):
    spec = make(method, fps, num_frames)
    speech = prepare(np.zeros(5 * 16000, np.float32), (), spec.training_inputs)
    cut = window(speech, spec.training_inputs, Vocabulary(()), 7, num_frames, fps)
    expected = {name: array.shape[1:] for name, array in example_batch(spec).items() if name in cut}
    assert {name: array.shape for name, array in cut.items()} == expected


@pytest.mark.parametrize(("fps", "num_frames"), [(20, 34), (25, 68), (30, 68)])
def test_a_sound_moves_the_features_of_its_frame(fps, num_frames):
    """What lies between columns is interpolated at the right time: a loud column acts around its own frame."""
    encoder = AudioEncoder((1, 1, 1, 1), (8, 8, 16, 32), (4, 1), 4, num_frames, fps)
    columns = int(num_frames / fps * 31.25)
    silence = jnp.full((1, 128, columns), -80.0)
    variables = jax.jit(functools.partial(encoder.init, train=False))(jax.random.key(0), silence)
    loud = [int(frame / fps * 31.25) for frame in (num_frames // 4, 3 * num_frames // 4)]
    mels = jnp.concatenate([silence, *(silence.at[:, :, column].set(0.0) for column in loud)])
    features: Any = jax.jit(functools.partial(encoder.apply, train=False))(variables, mels)
    assert_moved_at([column / 31.25 for column in loud], np.asarray(features.low), fps)


def assert_moved_at(times, features, fps):
    """Check where the later rows of features (B, N, values) differ from the first."""
    for time, row in zip(times, features[1:], strict=True):
        moved = np.abs(row - features[0]).sum(axis=-1)
        centre = np.sum(moved * (np.arange(len(row)) + 0.5)) / np.sum(moved) / fps
        assert abs(centre - time) < 0.1


@pytest.mark.parametrize(("fps", "num_frames"), [(15, 34), (30, 68)])
def test_steps_of_a_waveform_lie_at_their_time(fps, num_frames):
    """The features of a click lie where the click is."""
    encoder = WaveformEncoder(4, num_frames=num_frames, fps=fps)
    samples = jnp.zeros((1, round(num_frames * 16000 / fps)))
    variables = encoder.init(jax.random.key(0), samples, train=False)
    clicks = jnp.concatenate([samples, samples.at[:, 12000].set(1.0), samples.at[:, 28000].set(1.0)])
    features = np.asarray(encoder.apply(variables, clicks, train=False))
    assert_moved_at([12000 / 16000, 28000 / 16000], features, fps)


def test_a_setting_that_is_not_possible_is_refused_before_networks_are_built():
    config = presets.make("ted_gesture", "debug")
    config.data = config.data.to_dict() | {"fps": 29.97}
    with pytest.raises(UserError, match=r"config.data.fps is 29.97, expected a whole number from 15 to 30"):
        build(config, load_skeleton("ted_gesture"), 11, 5)


def test_equal_specs_are_one_static_argument():
    """Two models of one config are traced once."""
    first, second = make(), make()
    assert first == second and hash(first) == hash(second)
    traced = []
    count = jax.jit(lambda spec, x: traced.append(spec) or x + spec.num_frames, static_argnums=0)
    assert count(first, 1) == count(second, 1) == 35 and len(traced) == 1
    assert make(num_frames=68) != first
