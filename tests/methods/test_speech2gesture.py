"""Speech2Gesture has the layers of its table."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.methods.speech2gesture import PatchDiscriminator, Speech2Gesture, l1, lay_on_frames
from ha2g_jax.train.step import train_step

# Fewer layers than the paper's, which take long to compile.
SHALLOW = {"model__audio__spectrogram__channels": (4,), "model__inferer__layers": 1, "model__inferer__hidden_dim": 16}


def test_l1_is_the_mean_over_all_frames():
    poses, targets = jnp.array([[[0.0, -1.0], [3.0, -1.0]]]), jnp.array([[[1.0, -1.0], [1.0, -2.0]]])
    assert float(l1(poses, targets)) == pytest.approx((1 + 0 + 2 + 1) / 4)


def test_legacy_trains_as_the_published_comparison_did(make_objective, make_motion_batch, draw_state):
    """A step with the same parameters takes another input and has another discriminator."""
    objectives = [make_objective("speech2gesture", model__legacy=legacy, **SHALLOW) for legacy in (False, True)]
    assert [objective.spec.generator.swapped_axes for objective in objectives] == [False, True]
    assert [objective.spec.discriminator.differences for objective in objectives] == [1, 2]
    state, batch = draw_state(objectives[0]), make_motion_batch(objectives[0], 3)
    steps = [jax.jit(functools.partial(train_step, objective)) for objective in objectives]
    new, legacy = (step(state, batch, jax.random.key(1))[1] for step in steps)
    for name in ("loss/l1", "loss/discriminator"):
        assert jnp.isfinite(legacy[name]) and legacy[name] != pytest.approx(float(new[name]), rel=1e-3)


NUM_FRAMES = 34


def _variables(module, *arguments):
    """Return kernels that keep the magnitude of their input, and other generic values."""
    rng = np.random.default_rng(0)

    def draw(path, x):
        name = path[-1].key
        if name == "kernel":
            return rng.normal(0, np.prod(x.shape[:-1]) ** -0.5, x.shape).astype(np.float32)
        return (rng.normal(0, 0.2, x.shape) + (name in ("scale", "variance"))).astype(np.float32)

    shapes = jax.eval_shape(functools.partial(module.init, train=False), jax.random.key(0), *arguments)
    return jax.tree.map_with_path(draw, {name: dict(shapes[name]) for name in ("params", "batch_stats")})


def test_time_is_laid_on_frames_without_aligned_corners():
    x = np.random.default_rng(0).normal(size=(2, 14, 7, 3)).astype(np.float32)
    times = np.clip((np.arange(NUM_FRAMES) + 0.5) * 7 / NUM_FRAMES - 0.5, 0, 6)
    middle = (x[:, 6] + x[:, 7]) / 2
    expected = np.stack(
        [[np.interp(times, np.arange(7), middle[clip, :, channel]) for channel in range(3)] for clip in range(2)]
    ).transpose(0, 2, 1)
    np.testing.assert_allclose(jax.jit(lambda x: lay_on_frames(x, NUM_FRAMES))(x), expected, rtol=1e-5, atol=1e-6)


def test_swapped_axes_lay_frequency_on_the_frames():
    """As in the published comparison: every frame depends on the middle one of the 7 times only."""
    x = np.random.default_rng(0).normal(size=(2, 14, 7, 3)).astype(np.float32)
    swapped = jax.jit(lambda x: lay_on_frames(x, NUM_FRAMES, swapped=True))
    np.testing.assert_allclose(swapped(x), lay_on_frames(jnp.asarray(x.swapaxes(1, 2)), NUM_FRAMES), rtol=1e-6)
    elsewhere = x + (np.arange(7) != 3)[:, None].astype(np.float32)
    np.testing.assert_array_equal(swapped(elsewhere), swapped(x))


@pytest.mark.parametrize(("differences", "num_scores"), [(1, 9), (2, 8)])
def test_scores_are_of_differences(differences, num_scores):
    """Scores use first differences; in the published comparison second ones, which ignore a steady drift."""
    poses = np.random.default_rng(0).normal(size=(2, NUM_FRAMES, 5)).astype(np.float32)
    module = PatchDiscriminator(channels=4, differences=differences)
    variables = _variables(module, poses)
    score = jax.jit(lambda poses: module.apply(variables, poses, train=False))
    assert score(poses).shape == (2, num_scores)
    np.testing.assert_allclose(score(poses + 0.7), score(poses), atol=1e-5)
    drifting = poses + 0.5 * np.arange(NUM_FRAMES)[:, None].astype(np.float32)
    assert (np.abs(score(drifting) - score(poses)).max() > 0.01) == (differences == 1)


@pytest.mark.torch
def test_equals_pytorch(oracles):
    """The whole generator, in training and in evaluation, compared with the layers of its table in PyTorch."""
    torch = pytest.importorskip("torch")
    functional = torch.nn.functional
    rng = np.random.default_rng(5)
    mel = rng.uniform(-80, 0, (2, 128, 70)).astype(np.float32)
    seed = rng.normal(size=(2, 4, 6)).astype(np.float32)
    model = Speech2Gesture(pose_dim=6, audio_channels=(8, 8, 8), channels=9)
    variables = _variables(model, {"mel": mel}, None, seed)
    move = jax.jit(lambda it: it | model.apply(it, {"mel": mel}, None, seed, train=True, mutable=["batch_stats"])[1])
    for _ in range(20):  # to statistics that match, so that in evaluation no values vanish
        variables = move(variables)
    params, statistics = (jax.tree.map(np.asarray, variables[name]) for name in ("params", "batch_stats"))

    def tensor(x):
        return torch.from_numpy(np.array(x))

    def norm(x, name, params, statistics):
        statistics = statistics[name]
        return functional.batch_norm(
            x,
            tensor(statistics["mean"]),
            tensor(statistics["variance"]),
            tensor(params[name]["scale"]),
            tensor(params[name]["bias"]),
            training=train,
        )

    def block(x, params, statistics, stride=1, is_same=True):
        kernel = np.moveaxis(params["conv"]["kernel"], (-1, -2), (0, 1))
        if is_same:
            sizes = [(-(-n // stride) - 1) * stride + k - n for n, k in zip(x.shape[2:], kernel.shape[2:], strict=True)]
            x = functional.pad(x, [side for size in sizes[::-1] for side in (size // 2, size - size // 2)])
        convolve = functional.conv2d if x.ndim == 4 else functional.conv1d
        x = convolve(x, tensor(kernel), tensor(params["conv"]["bias"]), stride=stride)
        return functional.leaky_relu(norm(x, "norm", params, statistics), 0.2)

    def part(path):
        values = params, statistics
        for name in path.split("/"):
            values = tuple(value[name] for value in values)
        return values

    def dense(x, params):
        return x @ tensor(params["kernel"]) + tensor(params["bias"])

    for train in (False, True):
        x = tensor(mel)[:, None] / 80 + 1
        for index in range(3):
            x = block(x, *part(f"audio/block_{index}"))
            x = block(x, *part(f"audio/down_{index}"), stride=2)
        x = block(block(x, *part("audio/block_same")), *part("audio/block_valid"), is_same=False)
        x = functional.interpolate(x, size=(1, NUM_FRAMES), mode="bilinear", align_corners=False)[:, :, 0]
        x = block(block(x, *part("unet/block_0")), *part("unet/block_1"))
        skips = []
        for index in range(5):
            skips.append(x)
            x = block(x, *part(f"unet/down_{index}"), stride=2)
        for index, skip in enumerate(skips[::-1]):
            x = functional.interpolate(x, scale_factor=2, mode="nearest")[..., : skip.shape[-1]] + skip
            x = block(x, *part(f"unet/up_{index}"))
        start = torch.relu(norm(dense(tensor(seed).flatten(1), params["seed_in"]), "seed_norm", params, statistics))
        start = dense(start, params["seed_out"])[..., None].expand(-1, -1, NUM_FRAMES)
        x = torch.cat([x, start], dim=1)
        for index in range(4):
            x = block(x, *part(f"decoder_{index}"))
        output = {"kernel": params["output"]["kernel"][0], "bias": params["output"]["bias"]}
        expected = dense(x.transpose(1, 2), output).numpy()

        mutable = ["batch_stats"] if train else []
        run = functools.partial(model.apply, train=train, mutable=mutable)
        (found,), _ = jax.jit(lambda run=run: run(variables, {"mel": mel}, None, seed))()
        oracles.assert_close(found, expected, 1e-4)
