"""A generative HA2G, not in the paper: its networks also read noise and are trained with a proper scoring rule.

Speech does not determine where the hands are during a phrase, so a regression predicts the mean of the possible
positions. Here two samples of each window, made with independent noise, are scored against the true motion by the
energy score (Gneiting and Raftery 2007), whose expectation is least when they follow the true distribution. There is no
adversary, a sample takes one forward pass, and training samples as generation does. The same approach has been used for
speech (Gritsenko et al. 2020), regression (Shen and Meinshausen 2024) and weather forecasts (Alet et al. 2025).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ha2g_jax.config.settings import Config
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.methods.ha2g import losses
from ha2g_jax.methods.ha2g import method as ha2g
from ha2g_jax.methods.method import FLOAT32, Batch, Compute, Run, Spec, Variables, generator_arguments
from ha2g_jax.methods.networks import apply, draw_noise
from ha2g_jax.skeleton import Skeleton

# Added to mean squares before the square root, so that distances below 0.001 count little and gradients stay bounded.
_EPSILON = 1e-6
_SPAN = 8  # frames in each span of `velocity_distance`, so that the time of a stroke counts

rngs: tuple[str, ...] = ("dropout", "identity", "noise")
reconstruction_term = "energy"
has_parts = False
init_arguments = generator_arguments
encode_speech, encode_identity = ha2g.encode_speech, ha2g.encode_identity


class Terms(NamedTuple):
    """Terms of the objective, each an unweighted scalar (), or their weights as floats."""

    energy: jax.Array
    velocity: jax.Array
    kld: jax.Array
    contrastive: jax.Array


class LossSettings(NamedTuple):
    """Settings of the contrastive term, `config.loss.energy_ha2g`; the table of settings explains them."""

    temperature: float
    negatives: tuple[str, ...]


class Outputs(NamedTuple):
    """Outputs of the generator that gradients flow through: two samples of the poses, and the other outputs of HA2G."""

    poses: tuple[jax.Array, ...]  # H arrays (B, N, d^h), mean-subtracted
    others: tuple[jax.Array, ...]  # the second sample, in the same form
    features: Features  # of the audio, each (B, N, 32)
    text: jax.Array  # (B, N, 32)
    mean: jax.Array  # (B, 18) of the identity, like the log-variance
    log_variance: jax.Array


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Spec:
    """Build the networks of HA2G with the noise `config.model.inferer.noise_dim`; see `Method.build`."""
    spec, noise_dim = ha2g.build(config, skeleton, vocabulary_size, num_speakers), config.model.inferer.noise_dim
    return spec._replace(generator=spec.generator.clone(noise_dim=noise_dim), discriminator=None, noise_dim=noise_dim)


def sample(
    spec: Spec, variables: Variables, features: Any, style: jax.Array, seed_pose: jax.Array, noise: jax.Array
) -> jax.Array:
    """Generate the poses of windows, the last level of the hierarchy; see `GeneratingMethod`."""
    clips = (features, style, seed_pose, noise)
    return spec.generator.apply(variables, *clips, train=False, method="infer")[-1]


def run(
    spec: Spec,
    variables: Variables,
    batch: Batch,
    keys: dict[str, jax.Array],
    *,
    train: bool = True,
    compute: Compute = FLOAT32,
) -> Run[Outputs, None]:
    """Run the generator on one batch, for two samples of each window with the same identity; see `Method.run`.

    In evaluation mode the identity is the mean, not a sample.
    """
    speech, identity, seed_pose = generator_arguments(spec, batch)
    (features, text, (mean, log_variance)), batch_stats = apply(
        spec.generator, variables, keys["dropout"], speech, identity, train=train, compute=compute, method=ha2g.encode
    )
    f_id = ha2g.draw_identity(keys["identity"], mean, log_variance) if train else mean
    # Both samples of a clip are neighbours on the batch axis, so that no data moves between devices.
    clips = jax.tree.map(lambda x: jnp.repeat(x, 2, axis=0), (features, f_id, seed_pose))
    noise = draw_noise(spec, keys["noise"], 2 * len(mean))
    levels, _ = apply(
        spec.generator, variables, keys["dropout"], *clips, noise, train=train, compute=compute, method="infer"
    )
    pairs = [poses.reshape(-1, 2, *poses.shape[1:]) for poses in levels]
    poses, others = (tuple(pair[:, index] for pair in pairs) for index in (0, 1))
    return Run(Outputs(poses, others, Features(*features[:3]), text, mean, log_variance), None, batch_stats)


def terms(
    spec: Spec, settings: LossSettings, outputs: Outputs, constants: None, targets: jax.Array, gan: None
) -> Terms:
    """Return the unweighted terms; see `Method.terms`."""
    del constants, gan
    levels = tuple(targets[..., jnp.array(channels)] for channels in spec.generator.level_channels)
    samples = (outputs.poses, outputs.others, levels)
    return Terms(
        energy=energy_score(trajectory_distance, *samples),
        velocity=energy_score(velocity_distance, *samples),
        kld=losses.kld(outputs.mean, outputs.log_variance),
        contrastive=losses.contrastive(outputs.text, *outputs.features, **settings._asdict()),
    )


def energy_score(
    distance: Callable[[jax.Array, jax.Array], jax.Array],
    poses: Sequence[jax.Array],
    others: Sequence[jax.Array],
    targets: Sequence[jax.Array],
) -> jax.Array:
    """Return the energy score of two samples p and p' of each window, the sum over levels of the mean over windows of

        1/2 (d(p, y) + d(p', y)) - 1/2 d(p, p')

    where p, p' and the true poses y are each H arrays (B, N, d^h). The distance d maps two arrays of a level to (B,).
    """
    levels = [
        jnp.mean(distance(one, target) + distance(other, target) - distance(one, other)) / 2
        for one, other, target in zip(poses, others, targets, strict=True)
    ]
    return jnp.sum(jnp.stack(levels))


def trajectory_distance(one: jax.Array, other: jax.Array) -> jax.Array:
    """Return the distance (B,) between two motions (B, N, 3 bones).

    It is the mean over bones of the root mean square over time.
    """
    return jnp.mean(jnp.sqrt(jnp.mean(_squares(one - other), axis=1) + _EPSILON), axis=-1)


def velocity_distance(one: jax.Array, other: jax.Array) -> jax.Array:
    """Return the distance (B,) between the velocities of two motions: `trajectory_distance` in spans of 8 frames.

    The last span is padded with zeros: of the 33 differences of 34 frames, the last counts 2.8 times as much as any
    other.
    """
    squares = _squares(jnp.diff(one - other, axis=1))
    squares = jnp.pad(squares, ((0, 0), (0, -squares.shape[1] % _SPAN), (0, 0)))
    spans = squares.reshape(len(squares), -1, _SPAN, squares.shape[-1])
    return jnp.mean(jnp.sqrt(jnp.mean(spans, axis=2) + _EPSILON), axis=(1, 2))


def _squares(difference: jax.Array) -> jax.Array:
    """Return the squared lengths (B, T, bones) of vectors (B, T, 3 bones)."""
    vectors = difference.reshape(*difference.shape[:2], -1, 3)
    return jnp.sum(vectors**2, axis=-1)
