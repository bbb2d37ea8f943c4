"""The terms of the objective (HA2G, Eq. 9), each unweighted: arrays in, one scalar out.

A term knows neither modules nor weights; `ha2g_jax.methods.ha2g.method` calls them.
B is the batch, N the frames of a window, H the levels of the motion hierarchy.
"""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp

AUDIO_LEVELS = ("low", "mid", "high")

# Angles of rigid parts vary by almost nothing; the smallest variance in TED-Expressive is 2.6e-5.
_MIN_ANGLE_VARIANCE = 1e-5
# Norm below which a feature counts as zero: its cosine fades to 0 and its gradient stays below 1000.
_MIN_FEATURE_NORM = 1e-3
# Candidates of the contrastive term compared at once; bounds its memory at B N x 1024 values.
_CANDIDATE_BLOCK = 1024
_MIN_STYLE_DISTANCE = 1e-5


def huber(predictions: Sequence[jax.Array], targets: Sequence[jax.Array], delta: float = 0.1) -> jax.Array:
    """Reconstruction loss (Eq. 5), the mean over levels, frames and dimensions of

        h(x) = x^2 / (2 delta)  for |x| <= delta
               |x| - delta / 2  beyond

    Each level counts equally, whatever its number of dimensions. D8: delta is 0.1, and the line has slope 1
    (Huber's function over delta, also called smooth L1). With Huber's own scale the weight of 200 would leave
    this term weaker than the physical one (Eq. 8), which then holds every joint at its mean angle.

    Args:
        predictions, targets: H arrays (B, N, d^h) of mean-subtracted direction vectors.
        delta: where the parabola becomes a line.
    """
    levels = [jnp.mean(_huber(p - t, delta)) for p, t in zip(predictions, targets, strict=True)]
    return jnp.mean(jnp.stack(levels))


def physical(angles: jax.Array, mean: jax.Array, variance: jax.Array) -> jax.Array:
    """Physical constraint (Eq. 8), the mean over batch and frames of

        - sum_j log N(theta_j; mu_j, sigma_j^2)

    with the normalising constant, so the value may be negative.

    Args:
        angles: (B, N, pairs) angles of restored poses in units of pi (`skeleton.joint_angles` / pi).
        mean, variance: (pairs,) statistics in the same unit; a variance below 1e-5 counts as 1e-5.
    """
    variance = jnp.maximum(variance, _MIN_ANGLE_VARIANCE)
    deviation = (angles - mean[None, None]) ** 2 / (2 * variance)[None, None]
    normaliser = 0.5 * jnp.sum(jnp.log(2 * math.pi * variance))
    return jnp.mean(jnp.sum(deviation, axis=-1)) + normaliser


def style(
    poses: jax.Array,
    other_poses: jax.Array,
    f_id: jax.Array,
    other_f_id: jax.Array,
    *,
    delta: float = 0.1,
    clip: float = 1000.0,
) -> jax.Array:
    """Style diverging loss (Eq. 7), the mean over the batch of

        - min(Huber(p(f_1), p(f_2)) / ||f_1 - f_2||_1, epsilon)

    Both distances are sums (over frames and dimensions, over the 18 values of the identity): with means
    the ratio would be a few hundred times smaller, and neither it nor epsilon = 1000 would ever matter.
    `other_poses` and both identities are detached here, so that only the first output moves. Where
    identities and outputs coincide, ratio and gradient are zero; where the identities alone do, it is clipped.

    Args:
        poses, other_poses: (B, N, pose_dim) outputs for the two identities.
        f_id, other_f_id: (B, 18) the identities.
        delta: of the Huber distance.
        clip: epsilon.
    """
    other_poses, f_id, other_f_id = jax.lax.stop_gradient((other_poses, f_id, other_f_id))
    distance = jnp.sum(_huber(poses - other_poses, delta), axis=(1, 2))
    identity_distance = jnp.sum(jnp.abs(f_id - other_f_id), axis=-1)
    return -jnp.mean(jnp.minimum(distance / (identity_distance + _MIN_STYLE_DISTANCE), clip))


def kld(mean: jax.Array, log_variance: jax.Array) -> jax.Array:
    """KL divergence of the identities from N(0, I): -1/2 sum(1 + log s^2 - m^2 - s^2), the mean over the batch.

    Args:
        mean, log_variance: (B, 18) of the Gaussian an identity is sampled from.
    """
    return jnp.mean(-0.5 * jnp.sum(1 + log_variance - mean**2 - jnp.exp(log_variance), axis=-1))


def contrastive(
    text: jax.Array,
    low: jax.Array,
    mid: jax.Array,
    high: jax.Array,
    *,
    temperature: float = 0.07,
    negatives: tuple[str, ...] = AUDIO_LEVELS,
) -> jax.Array:
    """Multi-level contrastive loss (Eq. 2), the mean over all frames of

        - log( exp(sim(f_t, f_high) / tau) / sum_i sum_l exp(sim(f_t, f_l(i)) / tau) )

    where sim is the cosine, i runs over all frames of all clips of the batch (the positive included) and l
    over the three levels. The sum is taken in blocks of candidates, forward and backward, so that memory
    grows with B N and not with its square. A zero vector, such as silence may give, has cosine 0.

    Args:
        text, low, mid, high: (B, N, 32) features aligned in time.
        temperature: tau.
        negatives: the levels l of the sum; two rows of Table 3 leave some out. The positive is always in it.
    """
    dim = text.shape[-1]
    text, low, mid, high = (_unit(features.reshape(-1, dim)) for features in (text, low, mid, high))
    queries = text / temperature
    levels: dict[str, jax.Array] = {"low": low, "mid": mid, "high": high}
    denominator = _blocked_log_sum_exp(queries, jnp.concatenate([levels[name] for name in negatives]))
    positive = jnp.sum(queries * high, axis=-1)
    if "high" not in negatives:
        denominator = jnp.logaddexp(denominator, positive)
    return jnp.mean(denominator - positive)


def _huber(difference: jax.Array, delta: float) -> jax.Array:
    inside = jnp.clip(difference, -delta, delta)
    return inside * (difference - 0.5 * inside) / delta


def _unit(vectors: jax.Array) -> jax.Array:
    squared = jnp.sum(vectors**2, axis=-1, keepdims=True)
    return vectors * jax.lax.rsqrt(jnp.maximum(squared, _MIN_FEATURE_NORM**2))


@jax.custom_vjp
def _blocked_log_sum_exp(queries: jax.Array, candidates: jax.Array) -> jax.Array:
    """log sum_k exp(q_i . c_k) for queries (R, d) and candidates (K, d), as (R,)."""
    blocks, is_real = _blocks(candidates)

    def add_block(carry, block):
        maximum, total = carry
        logits = _logits(queries, *block)
        new_maximum = jnp.maximum(maximum, jnp.max(logits, axis=-1))
        total = total * jnp.exp(maximum - new_maximum) + jnp.sum(jnp.exp(logits - new_maximum[:, None]), axis=-1)
        return (new_maximum, total), None

    start = (jnp.full(queries.shape[:1], -jnp.inf, queries.dtype), jnp.zeros(queries.shape[:1], queries.dtype))
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
    """Candidates (K, d) cut into (blocks, size, d), the last one filled up, and (blocks, size) which are real."""
    count, dim = candidates.shape
    num_blocks = -(-count // _CANDIDATE_BLOCK)
    size = -(-count // num_blocks)
    padded = jnp.pad(candidates, ((0, num_blocks * size - count), (0, 0)))
    is_real = jnp.arange(num_blocks * size) < count
    return padded.reshape(num_blocks, size, dim), is_real.reshape(num_blocks, size)


def _logits(queries: jax.Array, candidates: jax.Array, is_real: jax.Array) -> jax.Array:
    return jnp.where(is_real[None], queries @ candidates.T, -jnp.inf)
