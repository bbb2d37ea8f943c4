"""Terms of the objective compared with numbers computed by hand, and at points where gradients may fail."""

import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.methods import adversarial
from ha2g_jax.methods.ha2g import losses
from ha2g_jax.skeleton import joint_angles, load_skeleton


def random_features(seed, batch=3, frames=5, dim=4):
    return tuple(jax.random.normal(key, (batch, frames, dim)) for key in jax.random.split(jax.random.key(seed), 4))


def dense_contrastive(text, low, mid, high, temperature=0.07):
    text, low, mid, high = (x.reshape(-1, x.shape[-1]) for x in (text, low, mid, high))
    text, low, mid, high = (x / jnp.linalg.norm(x, axis=-1, keepdims=True) for x in (text, low, mid, high))
    logits = text @ jnp.concatenate([high, mid, low]).T / temperature
    return -jnp.mean(jnp.diagonal(jax.nn.log_softmax(logits, axis=-1)))


def test_huber_is_a_parabola_inside_and_a_line_outside():
    target = [jnp.zeros((1, 1, 2))]
    inside, outside = (
        losses.huber([jnp.full((1, 1, 2), 0.05)], target),
        losses.huber([jnp.full((1, 1, 2), -0.3)], target),
    )
    assert inside == pytest.approx(0.05**2 / 0.2)
    assert outside == pytest.approx(0.3 - 0.05)
    assert losses.huber([jnp.full((1, 1, 2), -0.3)], target, delta=1.0) == pytest.approx(0.3**2 / 2)


def test_huber_adds_the_means_of_the_levels():
    """D14: a level counts as much beside five others as alone, whatever its number of dimensions."""
    predictions = [jnp.full((2, 3, 1), 0.1), jnp.full((2, 3, 9), 0.1)]
    targets = [jnp.zeros((2, 3, 1)), jnp.zeros((2, 3, 9))]
    assert losses.huber(predictions[:1], targets[:1]) == pytest.approx(0.1 / 2)
    assert losses.huber(predictions, targets) == pytest.approx(2 * 0.1 / 2)


def test_huber_slope_is_continuous_and_bounded():
    slope = jax.vmap(jax.grad(lambda x: losses.huber([jnp.reshape(x, (1, 1, 1))], [jnp.zeros((1, 1, 1))])))
    np.testing.assert_allclose(slope(jnp.array([0.0, 0.09, 0.1, 0.11, -5.0])), [0, 0.9, 1, 1, -1], atol=1e-6)


def test_physical_is_the_sum_of_gaussian_log_densities():
    angles = jnp.array([[[0.5, 0.2]]])
    expected = sum(
        0.5 * math.log(2 * math.pi * variance) + (angle - mean) ** 2 / (2 * variance)
        for angle, mean, variance in ((0.5, 0.4, 0.01), (0.2, 0.2, 0.04))
    )
    value = losses.physical(angles, jnp.array([0.4, 0.2]), jnp.array([0.01, 0.04]))
    assert value == pytest.approx(expected, rel=1e-6)


def test_physical_leaves_out_pairs_that_hardly_move():
    """D13: a standard deviation of 1.9 degrees is rigid, one of 2.1 degrees is not."""
    angles, mean = jnp.array([[[0.5, 0.4, 0.2]]]), jnp.full(3, 0.3)
    moving, rigid = (2.1 / 180) ** 2, (1.9 / 180) ** 2
    variance = jnp.array([rigid, moving, 0.0])
    value, gradient = jax.jit(jax.value_and_grad(losses.physical))(angles, mean, variance)
    assert value == pytest.approx(float(losses.physical(angles[..., 1:2], mean[1:2], variance[1:2])), rel=1e-5)
    np.testing.assert_allclose(gradient[0, 0], [0, (0.4 - 0.3) / moving, 0], rtol=1e-5)
    assert losses.physical(angles, mean, jnp.zeros(3)) == 0


def test_angle_is_the_mean_over_frames_of_the_sum_of_squares():
    """D21."""
    angles, targets = jnp.array([[[0.5, 0.2, 0.1], [0.3, 0.3, 0.3]]]), jnp.array([[[0.5, 0.5, 0.0], [0.3, 0.3, 0.3]]])
    assert losses.angle(angles, targets) == pytest.approx((0.3**2 + 0.1**2) / 2, rel=1e-5)


def test_every_rigid_pair_of_ted_is_a_palm_or_the_head():
    skeleton = load_skeleton("ted_expressive")
    rigid = np.flatnonzero(losses.is_rigid(np.asarray(skeleton.angle_variance)))
    ends = [{skeleton.joints[skeleton.bones[bone][1]] for bone in skeleton.angle_pairs[pair]} for pair in rigid]
    palm = ("thumb", "index", "middle", "ring", "pinky")
    expected = [
        {f"{side}_{a}_1", f"{side}_{b}_1"} for side in ("left", "right") for a, b in itertools.pairwise(palm)
    ] + [{f"{side}_eye", f"{side}_ear"} for side in ("left", "right")]
    assert sorted(map(sorted, ends)) == sorted(map(sorted, expected))
    assert not losses.is_rigid(np.asarray(load_skeleton("ted_gesture").angle_variance)).any()


def test_physical_gradient_is_finite_at_parallel_opposite_and_zero_bones():
    skeleton = load_skeleton("ted_expressive")
    sign = jnp.where(jnp.arange(skeleton.num_bones) % 2 == 0, 1.0, -1.0)[:, None]

    def loss(directions):
        angles = joint_angles(skeleton, directions) / jnp.pi
        return losses.physical(angles, jnp.asarray(skeleton.angle_mean), jnp.asarray(skeleton.angle_variance))

    both = jax.jit(jax.value_and_grad(loss))
    for bones in (jnp.ones((skeleton.num_bones, 3)), sign * jnp.ones((1, 3)), jnp.zeros((skeleton.num_bones, 3))):
        value, gradient = both(bones[None, None])
        assert jnp.isfinite(value)
        assert jnp.isfinite(gradient).all()


def test_style_is_the_ratio_of_the_two_distances_of_each_sample():
    poses, other = jnp.zeros((2, 2, 3)), jnp.stack([jnp.full((2, 3), 0.05), jnp.full((2, 3), 0.3)])
    f_id, other_f_id = jnp.zeros((2, 4)), jnp.stack([jnp.full(4, 0.5), jnp.full(4, -1.0)])
    ratios = [6 * 0.05**2 / 0.1 / 0.5, 6 * (0.3 - 0.025) / 1.0]  # D15: sums over the mean of |f_1 - f_2|, delta 0.05
    assert losses.style(poses, other, f_id, other_f_id) == pytest.approx(-np.mean(ratios), rel=1e-4)
    clipped = losses.style(poses, other, f_id, other_f_id, clip=0.01)
    assert clipped == pytest.approx(-0.01, rel=1e-4)


def test_style_moves_the_first_output_alone():
    poses, other, f_id, other_f_id = random_features(0)
    gradients = jax.jit(jax.grad(losses.style, argnums=(0, 1, 2, 3)))(poses, other, f_id[:, 0], other_f_id[:, 0])
    assert [bool(jnp.any(gradient != 0)) for gradient in gradients] == [True, False, False, False]


def test_style_of_identical_identities_is_zero_with_no_gradient():
    poses, _, f_id, _ = random_features(0)
    value, gradient = jax.jit(jax.value_and_grad(losses.style))(poses, poses, f_id[:, 0], f_id[:, 0])
    assert value == 0
    np.testing.assert_array_equal(gradient, jnp.zeros_like(poses))


def test_kld_is_zero_for_the_prior_and_known_elsewhere():
    zeros = jnp.zeros((2, 18))
    assert losses.kld(zeros, zeros) == 0
    assert losses.kld(jnp.full((2, 18), 2.0), zeros) == pytest.approx(2.0)  # D16: the mean over the 18 values
    assert losses.kld(zeros, jnp.full((2, 18), 1.0)) == pytest.approx((math.e - 2) / 2, rel=1e-6)


def test_contrastive_of_one_frame():
    one, two = jnp.array([[[3.0, 0.0]]]), jnp.array([[[0.0, 0.2]]])
    expected = -math.log(math.exp(1 / 0.07) / (math.exp(1 / 0.07) + 2))
    assert losses.contrastive(one, two, two, one) == pytest.approx(expected, abs=1e-5)
    assert losses.contrastive(one, one, two, one, temperature=1.0) == pytest.approx(math.log(2 + math.exp(-1)))


@pytest.mark.parametrize("block", [1, 7, 15, 1024])
def test_contrastive_in_blocks_equals_the_whole_matrix(block, monkeypatch):
    monkeypatch.setattr("ha2g_jax.methods.ha2g.losses._CANDIDATE_BLOCK", block)
    features = random_features(1)
    value, gradients = jax.jit(jax.value_and_grad(losses.contrastive, argnums=(0, 1, 2, 3)))(*features)
    expected, expected_gradients = jax.jit(jax.value_and_grad(dense_contrastive, argnums=(0, 1, 2, 3)))(*features)
    assert value == pytest.approx(float(expected), rel=1e-5)
    for gradient, other in zip(gradients, expected_gradients, strict=True):
        np.testing.assert_allclose(gradient, other, atol=1e-5)


def test_contrastive_without_some_negatives():
    """Two rows of Table 3: levels that are left out are no candidates, but the positive always is."""
    text, low, mid, high = random_features(1)
    unit = [x.reshape(-1, x.shape[-1]) / jnp.linalg.norm(x, axis=-1).reshape(-1, 1) for x in (text, low, mid, high)]
    logits = {name: unit[0] @ level.T / 0.07 for name, level in zip(("low", "mid", "high"), unit[1:], strict=True)}
    positive = jnp.diagonal(logits["high"])
    for negatives in (("low", "mid"), ("high",)):
        candidates = [logits[name] for name in negatives]
        if "high" not in negatives:
            candidates.append(positive[:, None])
        expected = jnp.mean(jax.nn.logsumexp(jnp.concatenate(candidates, axis=1), axis=1) - positive)
        found = jax.jit(functools.partial(losses.contrastive, negatives=negatives))(text, low, mid, high)
        assert found == pytest.approx(float(expected), rel=1e-5)


def test_contrastive_of_silence_is_finite():
    text, *_ = random_features(2)
    zeros = jnp.zeros_like(text)
    both = jax.jit(jax.value_and_grad(losses.contrastive, argnums=(0, 1, 2, 3)))
    for first in (text, zeros):
        value, gradients = both(first, zeros, zeros, zeros)
        assert value == pytest.approx(math.log(3 * 15), rel=1e-5)
        assert all(jnp.isfinite(gradient).all() for gradient in gradients)


def test_contrastive_memory_grows_with_the_batch_and_not_with_its_square():
    def memory(batch):
        features = [jax.ShapeDtypeStruct((batch, 34, 32), jnp.float32)] * 4
        step = jax.jit(jax.value_and_grad(losses.contrastive, argnums=(0, 1, 2, 3)))
        analysis = step.lower(*features).compile().memory_analysis()
        assert analysis is not None
        return analysis.temp_size_in_bytes

    assert memory(256) < 5 * memory(64)  # and not 16 times; the blocks of the smaller batch are a little smaller too


def test_least_squares_adversary_by_hand():
    real, fake = jnp.array([[1.0, 0.5]]), jnp.array([[0.0, 2.0]])
    assert adversarial.gan_discriminator(real, fake, kind="least_squares") == pytest.approx(0.125 + 2)
    assert adversarial.gan_generator(fake, kind="least_squares") == pytest.approx(1)


def test_adversarial_losses_at_undecided_and_extreme_logits():
    undecided, sure = jnp.zeros(3), jnp.full(3, 1e4)
    assert adversarial.gan_generator(undecided) == pytest.approx(math.log(2))
    assert adversarial.gan_generator(undecided, kind="minimax") == pytest.approx(-math.log(2))
    assert adversarial.gan_discriminator(undecided, undecided) == pytest.approx(2 * math.log(2))
    assert adversarial.gan_discriminator(sure, -sure) == pytest.approx(0)
    for kind in ("non_saturating", "minimax"):
        value, gradient = jax.value_and_grad(lambda x, kind=kind: adversarial.gan_generator(x, kind=kind))(-sure)
        assert jnp.isfinite(value)
        assert jnp.isfinite(gradient).all()
