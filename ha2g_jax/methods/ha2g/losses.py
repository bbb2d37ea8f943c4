"""Terms of the objective (HA2G, Eq. 9), each unweighted: functions from arrays to one scalar.

The terms use neither modules nor weights; `ha2g_jax.methods.ha2g.method` calls them. B is the size of the batch, N the
number of frames of a window, and H the number of levels of the motion hierarchy.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

# D13: the variance, in units of pi^2, of an angle with a standard deviation of 2 degrees; pairs below it are rigid.
_RIGID_VARIANCE = (2 / 180) ** 2
# Norm below which a feature counts as zero: its cosine fades to 0 and its gradient stays below 1000.
_MIN_FEATURE_NORM = 1e-3
# Number of candidates of the contrastive term in one block, which bounds its memory to B N x 1024 values.
_CANDIDATE_BLOCK = 1024
_MIN_STYLE_DISTANCE = 1e-5


def huber(predictions: Sequence[jax.Array], targets: Sequence[jax.Array], delta: float = 0.1) -> jax.Array:
    """Return the reconstruction loss (Eq. 5), the sum over levels of the mean over frames and dimensions of

        h(x) = x^2 / (2 delta)  for |x| <= delta
               |x| - delta / 2  otherwise

    of H arrays (B, N, d^h) of mean-subtracted direction vectors. Each level counts equally, whatever its number of
    dimensions. D8: delta is 0.1, and the linear part has slope 1 (Huber's function divided by delta, also called smooth
    L1). D14: the levels are summed, not averaged, as in the public code, so that the last level has the same weight
    with 3 levels as with 6.
    """
    levels = [jnp.mean(smooth_l1(p - t, delta)) for p, t in zip(predictions, targets, strict=True)]
    return jnp.sum(jnp.stack(levels))


def physical(angles: jax.Array, mean: jax.Array, variance: jax.Array) -> jax.Array:
    """Return the physical constraint (Eq. 8), the mean over batch and frames of

        - sum_j log N(theta_j; mu_j, sigma_j^2)

    over the pairs j that move, including the normalising constant, so that the value may be negative. D13: rigid pairs
    are left out (`is_rigid`). Because of the division by a variance near 0, their gradient would be many times that of
    all other terms, and the Huber term fits their bones anyway. If all pairs are rigid, the loss is 0.

    Args:
        angles: (B, N, pairs) angles of restored poses in units of pi (`skeleton.joint_angles` / pi).
        mean, variance: (pairs,) statistics of the training split in the same unit.
    """
    is_moving = ~is_rigid(variance)
    variance = jnp.where(is_moving, variance, 1.0)
    precision = is_moving / variance
    deviation = 0.5 * jnp.sum((angles - mean[None, None]) ** 2 * precision[None, None], axis=-1)
    normaliser = 0.5 * jnp.sum(jnp.where(is_moving, jnp.log(2 * math.pi * variance), 0.0))
    return jnp.mean(deviation) + normaliser


def angle(angles: jax.Array, targets: jax.Array) -> jax.Array:
    """Return the squared error of the angles, a term of our own (D21), the mean over batch and frames of

        sum_j (theta_j - theta'_j)^2

    over all pairs j of Eq. 8. `huber` compares directions in space, which for a finger depend mostly on the palm; how
    far the finger is bent is an angle. A squared error is least at the mean of the possible outcomes, so that fingers
    bend a little before a word is certain. An absolute error, which `huber` nearly is, is least at the median, so that
    they stay at rest.

    Args:
        angles, targets: (B, N, pairs) angles of the poses and of the true poses in units of pi.
    """
    return jnp.mean(jnp.sum((angles - targets) ** 2, axis=-1))


def is_rigid(variance: Any) -> Any:
    """Return for each pair of bones whether it is rigid (D13), from the variance of its angle in units of pi^2."""
    return variance < _RIGID_VARIANCE


def style(
    poses: jax.Array,
    other_poses: jax.Array,
    f_id: jax.Array,
    other_f_id: jax.Array,
    *,
    delta: float = 0.05,
    clip: float = 1000.0,
) -> jax.Array:
    """Return the style diverging loss (Eq. 7), the mean over the batch of

        - min(Huber(p(f_1), p(f_2)) / (||f_1 - f_2||_1 + 1e-5), epsilon)

    of outputs (B, N, pose_dim) for two styles (B, 18), with `clip` for epsilon. D15: the scale is that of the public
    code. Huber's function, divided by delta as in `huber`, is summed over frames and dimensions; the distance of the
    styles is the mean over their values, which makes the term 18 times as large as with the L1 norm. No gradient passes
    through `other_poses` and the styles. The paper has no 1e-5 in the denominator; it makes ratio and gradient zero
    where both the styles and the outputs are equal.
    """
    other_poses, f_id, other_f_id = jax.lax.stop_gradient((other_poses, f_id, other_f_id))
    distance = jnp.sum(smooth_l1(poses - other_poses, delta), axis=(1, 2))
    identity_distance = jnp.mean(jnp.abs(f_id - other_f_id), axis=-1)
    return -jnp.mean(jnp.minimum(distance / (identity_distance + _MIN_STYLE_DISTANCE), clip))


def kld(mean: jax.Array, log_variance: jax.Array) -> jax.Array:
    """Return the KL divergence of the styles from N(0, I), the mean over the batch and the values of a style of

        -1/2 (1 + log s^2 - m^2 - s^2)

    for means m and log-variances log s^2 (B, 18). D16: we take the mean over the values, as the public code does, and
    the weight of 0.1 is meant for it. With the sum over the 18 values, all styles collapse to the prior at this weight.
    """
    return jnp.mean(-0.5 * (1 + log_variance - mean**2 - jnp.exp(log_variance)))


def contrastive(
    text: jax.Array,
    low: jax.Array,
    mid: jax.Array,
    high: jax.Array,
    *,
    temperature: float = 0.07,
    negatives: Sequence[str] = ("low", "mid", "high"),
) -> jax.Array:
    """Return the multi-level contrastive loss (Eq. 2), the mean over all frames of

        - log( exp(sim(f_t, f_high) / tau) / sum_i sum_l exp(sim(f_t, f_l(i)) / tau) )

    of features (B, N, 32) aligned in time, where sim is the cosine, i runs over all frames of all windows of the batch
    (including the positive) and l over the levels in `negatives`; two rows of Table 3 leave some out. The positive is
    always part of the sum. Both passes compute the sum in blocks of candidates, so that memory grows with B N and not
    with its square. A zero vector, which silence may cause, has cosine 0. Reverse-mode gradients work; forward mode
    (`jax.jvp`) does not.
    """
    dim = text.shape[-1]
    text, low, mid, high = (_unit(features.reshape(-1, dim)) for features in (text, low, mid, high))
    queries = text / temperature
    levels: dict[str, jax.Array] = {"low": low, "mid": mid, "high": high}
    denominator = _blocked_log_sum_exp(queries, jnp.concatenate([x for name, x in levels.items() if name in negatives]))
    positive = jnp.sum(queries * high, axis=-1)
    if "high" not in negatives:
        denominator = jnp.logaddexp(denominator, positive)
    return jnp.mean(denominator - positive)


def smooth_l1(difference: jax.Array, delta: float) -> jax.Array:
    """Return Huber's function of differences, divided by delta; see `huber`."""
    inside = jnp.clip(difference, -delta, delta)
    return inside * (difference - 0.5 * inside) / delta


def _unit(vectors: jax.Array) -> jax.Array:
    squared = jnp.sum(vectors**2, axis=-1, keepdims=True)
    return vectors * jax.lax.rsqrt(jnp.maximum(squared, _MIN_FEATURE_NORM**2))


@jax.custom_vjp
def _blocked_log_sum_exp(queries: jax.Array, candidates: jax.Array) -> jax.Array:
    """Return log sum_k exp(q_i . c_k) (R,) for queries (R, d) and candidates (K, d)."""
    blocks, is_real = _blocks(candidates)

    def add_block(carry, block):
        maximum, total = carry
        logits = _logits(queries, *block)
        new_maximum = jnp.maximum(maximum, jnp.max(logits, axis=-1))
        total = total * jnp.exp(maximum - new_maximum) + jnp.sum(jnp.exp(logits - new_maximum[:, None]), axis=-1)
        return (new_maximum, total), None

    start = (jnp.full_like(queries[:, 0], -jnp.inf), jnp.zeros_like(queries[:, 0]))
    (maximum, total), _ = jax.lax.scan(add_block, start, (blocks, is_real))
    return maximum + jnp.log(total)


def _forward(queries: jax.Array, candidates: jax.Array):
    value = _blocked_log_sum_exp(queries, candidates)
    return value, (queries, candidates, value)


def _backward(residuals, cotangent: jax.Array):
    queries, candidates, value = residuals
    blocks, is_real = _blocks(candidates)

    def add_block(query_gradient, block):
        weights = jnp.exp(_logits(queries, *block) - value[:, None]) * cotangent[:, None]
        return query_gradient + weights @ block[0], weights.T @ queries

    query_gradient, block_gradients = jax.lax.scan(add_block, jnp.zeros_like(queries), (blocks, is_real))
    return query_gradient, block_gradients.reshape(-1, queries.shape[-1])[: candidates.shape[0]]


_blocked_log_sum_exp.defvjp(_forward, _backward)


def _blocks(candidates: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Cut candidates (K, d) into padded blocks (blocks, size, d); also return which are not padding, (blocks, size)."""
    count, dim = candidates.shape
    num_blocks = -(-count // _CANDIDATE_BLOCK)
    size = -(-count // num_blocks)
    padded = jnp.pad(candidates, ((0, num_blocks * size - count), (0, 0)))
    is_real = jnp.arange(num_blocks * size) < count
    return padded.reshape(num_blocks, size, dim), is_real.reshape(num_blocks, size)


def _logits(queries: jax.Array, candidates: jax.Array, is_real: jax.Array) -> jax.Array:
    return jnp.where(is_real[None], queries @ candidates.T, -jnp.inf)
