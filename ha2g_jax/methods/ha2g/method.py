"""HA2G: the hierarchical audio learner and pose inferer with the objective of Eq. 9."""

import functools
import reprlib
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.features.spectrum import NUM_ASR_MELS
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.layers.whisper import AsrAudioEncoder, WhisperEncoder
from ha2g_jax.methods import networks
from ha2g_jax.methods.adversarial import Discriminator
from ha2g_jax.methods.ha2g import losses
from ha2g_jax.methods.ha2g.model import HA2G
from ha2g_jax.methods.method import (
    FLOAT32,
    Batch,
    Compute,
    Run,
    Spec,
    Variables,
    generator_arguments,
    make_spec,
    restore,
)
from ha2g_jax.methods.networks import apply, identity_encoder, infer_both, resnet_se, text_encoder
from ha2g_jax.skeleton import Skeleton, joint_angles

rngs: tuple[str, ...] = ("dropout", "identity", "permutation")
reconstruction_term = "huber"
has_parts = True
init_arguments = generator_arguments
encode_speech, encode_identity, sample = networks.encode_speech, networks.encode_identity, networks.sample


class Terms(NamedTuple):
    """Terms of Eq. 9, each an unweighted scalar (), or their weights as floats; `losses` has the equations.

    `angle` is not in Eq. 9 (D21); its weight is 0 except in the factorial study.
    """

    gan: jax.Array
    huber: jax.Array
    physical: jax.Array
    style: jax.Array
    kld: jax.Array
    contrastive: jax.Array
    angle: jax.Array


class LossSettings(NamedTuple):
    """Settings of the terms, `config.loss.ha2g`; the table of settings explains them."""

    huber_delta: float
    temperature: float
    negatives: tuple[str, ...]
    style_delta: float
    style_clip: float
    text: str


class Outputs(NamedTuple):
    """Outputs of the generator that gradients flow through."""

    poses: tuple[jax.Array, ...]  # H arrays (B, N, d^h), mean-subtracted
    features: Features  # of the audio, each (B, N, 32)
    text: jax.Array  # (B, N, 32)
    mean: jax.Array  # (B, 18) of the identity, like the log-variance
    log_variance: jax.Array


class Constants(NamedTuple):
    """Values for the style term, without a gradient: each clip's f_id, another identity of the batch, both (B, 18), and
    the poses (B, N, pose_dim) of the last level for the same speech with the other identity.
    """

    poses: jax.Array
    f_id: jax.Array
    other_f_id: jax.Array


_roll = functools.partial(jnp.roll, axis=0)


def run(
    spec: Spec,
    variables: Variables,
    batch: Batch,
    keys: dict[str, jax.Array],
    *,
    train: bool = True,
    compute: Compute = FLOAT32,
    exchange: Callable[[jax.Array, jax.Array], jax.Array] = _roll,
) -> Run[Outputs, Constants]:
    """Run the generator on one batch, with the identities of its clips and with a permutation of them.

    Audio, text and identity are encoded once for the whole batch, as BatchNorm needs. The pose inferer runs once for
    each of the two identities of a clip. It treats each clip by itself, so that in training it can process the batch in
    `compute.num_parts` parts. In evaluation mode the identity is the mean, not a sample. `exchange` maps the identities
    (B, 18) and a shift () to identities (B, 18) of other clips; see also `Method.run`.
    """
    speech, identity, seed_pose = generator_arguments(spec, batch)
    (features, text, (mean, log_variance)), batch_stats = apply(
        spec.generator, variables, keys["dropout"], speech, identity, train=train, compute=compute, method=encode
    )
    f_id = draw_identity(keys["identity"], mean, log_variance) if train else mean
    # A cyclic shift of the batch, so that no clip keeps its own identity unless it is the only one.
    shift = jax.random.randint(keys["permutation"], (), 1, max(len(mean), 2))
    other_f_id = jax.lax.stop_gradient(exchange(f_id, shift))

    def infer(key: jax.Array, clips: Any) -> tuple[tuple[jax.Array, ...], jax.Array]:
        return infer_both(spec, variables, key, *clips, train=train, compute=compute)

    clips = (features, f_id, other_f_id, seed_pose)
    if train and compute.num_parts > 1:
        poses, other_poses = _in_parts(infer, compute.num_parts, keys["dropout"], clips)
    else:
        poses, other_poses = infer(keys["dropout"], clips)
    outputs = Outputs(poses, Features(*features[:3]), text, mean, log_variance)
    return Run(outputs, Constants(other_poses, f_id, other_f_id), batch_stats)


def encode(model: HA2G, speech: dict[str, jax.Array], identity: jax.Array, *, train: bool) -> Any:
    """Encode audio, text and identity with a bound model."""
    return (
        model.encode_speech(speech, train=train),
        model.encode_text(speech["words"], train=train),
        model.encode_identity(identity, train=train),
    )


def draw_identity(key: jax.Array, mean: jax.Array, log_variance: jax.Array) -> jax.Array:
    """Draw f_id (B, 18) from its distribution."""
    return mean + jnp.exp(0.5 * log_variance) * jax.random.normal(key, mean.shape, mean.dtype)


def terms(
    spec: Spec, settings: LossSettings, outputs: Outputs, constants: Constants, targets: jax.Array, gan: jax.Array
) -> Terms:
    """Return the unweighted terms of Eq. 9; see `Method.terms`."""
    skeleton = spec.skeleton
    angles, true = (joint_angles(skeleton, restore(spec, poses)) / jnp.pi for poses in (outputs.poses[-1], targets))
    levels = tuple(targets[..., jnp.array(channels)] for channels in spec.generator.level_channels)
    text = outputs.text if settings.text == "own" else jnp.roll(outputs.text, 1, axis=0)
    return Terms(
        gan=gan,
        huber=losses.huber(outputs.poses, levels, settings.huber_delta),
        physical=losses.physical(angles, jnp.asarray(skeleton.angle_mean), jnp.asarray(skeleton.angle_variance)),
        style=losses.style(outputs.poses[-1], *constants, delta=settings.style_delta, clip=settings.style_clip),
        kld=losses.kld(outputs.mean, outputs.log_variance),
        contrastive=losses.contrastive(
            text, *outputs.features, temperature=settings.temperature, negatives=settings.negatives
        ),
        angle=losses.angle(angles, true),
    )


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Spec:
    """Build the networks of `config.model`, including the ablations of Tables 3 and 4; see `Method.build`.

    Raises:
        UserError: the inferer cannot have these levels, or Whisper's mel spectrogram has another size.
    """
    audio, inferer = config.model.audio, config.model.inferer
    encoder = _whisper(config) if audio.kind == "whisper" else resnet_se(config)
    generator = HA2G(
        audio=encoder,
        text=text_encoder(config, vocabulary_size),
        identity=identity_encoder(config, num_speakers),
        level_channels=_level_channels(inferer.levels, skeleton),
        audio_levels=tuple(name for name in Features._fields if name in audio.levels),
        is_tied=inferer.coordinator == "tied",
        has_coordinator=inferer.coordinator != "none",
        reads_words=config.model.text.kind == "oracle",
        num_seed_frames=config.data.num_seed_frames,
        hidden_dim=inferer.hidden_dim,
        layers=inferer.layers,
        dropout=inferer.dropout,
    )
    discriminator = Discriminator(**config.model.discriminator)
    inputs = (*encoder.inputs, "words")
    # Only the contrastive loss needs the words; generation does not.
    needed = inputs if generator.reads_words else encoder.inputs
    return make_spec(config, skeleton, generator, discriminator, inputs=needed, training_inputs=inputs)


def _level_channels(levels: tuple[int, ...], skeleton: Skeleton) -> tuple[tuple[int, ...], ...]:
    """Return the channels of each level that has a stage: of all levels, or of those that an ablation keeps."""
    numbers = tuple(levels) or tuple(range(1, skeleton.num_levels + 1))
    if list(numbers) != sorted(set(numbers)) or numbers[0] < 1 or numbers[-1] != skeleton.num_levels:
        raise UserError(
            f"config.model.inferer.levels is {reprlib.repr(numbers)}, expected ascending numbers from 1 that end with "
            f"{skeleton.num_levels}, the whole pose"
        )
    return tuple(skeleton.level_channels[number - 1] for number in numbers)


def _whisper(config: Config) -> AsrAudioEncoder:
    audio, data = config.model.audio, config.data
    if audio.whisper.num_mels != NUM_ASR_MELS:
        raise UserError(
            f"config.model.audio.whisper.num_mels is {audio.whisper.num_mels}, expected {NUM_ASR_MELS}: choose a "
            "Whisper model other than large-v3"
        )
    return AsrAudioEncoder(
        whisper=WhisperEncoder(**audio.whisper),
        feature_dim=audio.feature_dim,
        num_frames=data.num_frames,
        fps=data.fps,
    )


def _in_parts(function: Any, count: int, key: jax.Array, clips: Any) -> Any:
    """Return `function(key, clips)`, computed for one part of the clips after the other.

    Intermediate results of a part are not kept, but computed again for the gradient. Part p has clips p, p + count, ...
    As the clips of a device are neighbours, each part has equally many from every device and no clip moves, if `count`
    divides the clips of a device. Else a part is gathered on every device, which costs the memory that parts save.
    """

    def divide(x: jax.Array) -> jax.Array:
        return jnp.moveaxis(x.reshape(len(x) // count, count, *x.shape[1:]), 1, 0)

    def join(x: jax.Array) -> jax.Array:
        return jnp.moveaxis(x, 0, 1).reshape(-1, *x.shape[2:])

    inputs = (jax.random.split(key, count), jax.tree.map(divide, clips))
    # The loop itself keeps the forward pass and its recomputation apart; optimisation barriers would only cost time.
    part = jax.checkpoint(lambda inputs: function(*inputs), prevent_cse=False)
    return jax.tree.map(join, jax.lax.map(part, inputs))
