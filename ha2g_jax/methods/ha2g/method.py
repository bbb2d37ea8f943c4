"""HA2G: the hierarchical audio learner and pose inferer with the objective of Eq. 9."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ha2g_jax.config import Config
from ha2g_jax.errors import UserError
from ha2g_jax.features.asr_mel import ASR_COLUMNS, ASR_COLUMNS_PER_SECOND, NUM_ASR_MELS
from ha2g_jax.layers.asr_audio import AsrAudioEncoder
from ha2g_jax.layers.discriminator import Discriminator
from ha2g_jax.layers.identity import ImageIdentity, SpeakerIdentity
from ha2g_jax.layers.resnet_se import AudioEncoder
from ha2g_jax.layers.whisper import WhisperEncoder
from ha2g_jax.methods.choices import choice, some_of
from ha2g_jax.methods.encoders import speaker_table, text_encoder
from ha2g_jax.methods.forward import Batch, Variables, apply
from ha2g_jax.methods.ha2g import losses
from ha2g_jax.methods.ha2g.model import HA2G
from ha2g_jax.methods.task import Method, Networks, Task, restore, subtract_mean
from ha2g_jax.skeleton import Skeleton, joint_angles

TERMS = ("gan", "huber", "physical", "style", "kld", "contrastive")

# What each kind of E_a hears.
_AUDIO_INPUTS = {"resnet_se": "mel", "whisper": "asr_mel"}
_COORDINATORS = ("levels", "tied")


class Outputs(NamedTuple):
    """What the objective is differentiated by.

    Attributes:
        poses: H arrays (B, N, d^h), mean-subtracted.
        features: low, mid and high audio features, each (B, N, 32).
        text: (B, N, 32) text features.
        mean, log_variance: (B, 18) of the identity.
    """

    poses: tuple[jax.Array, ...]
    features: tuple[jax.Array, jax.Array, jax.Array]
    text: jax.Array
    mean: jax.Array
    log_variance: jax.Array


class Contrast(NamedTuple):
    """The same speech with another identity of the batch; no gradient flows through it.

    Attributes:
        poses: (B, N, pose_dim) of the last level.
        f_id: (B, 18) identity of `Outputs.poses`.
        other_f_id: (B, 18) identity of `poses`.
    """

    poses: jax.Array
    f_id: jax.Array
    other_f_id: jax.Array


def inputs(config: Config) -> tuple[str, ...]:
    """What a training example has of the speech: E_t's words too, which generation does without."""
    return _AUDIO_INPUTS[choice("model.audio.kind", config.model.audio.kind, tuple(_AUDIO_INPUTS))], "words"


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Networks:
    """The networks of `config.model`, the ablations of Tables 3 and 4 included.

    Raises:
        UserError: an unknown choice.
    """
    audio, inferer = config.model.audio, config.model.inferer
    generator = HA2G(
        audio=_audio_encoder(config),
        text=text_encoder(config, vocabulary_size),
        identity=_identity_encoder(config, num_speakers),
        level_channels=_level_channels(inferer.levels, skeleton),
        audio_levels=some_of("model.audio.levels", audio.levels, losses.AUDIO_LEVELS),
        is_tied=choice("model.inferer.coordinator", inferer.coordinator, _COORDINATORS) == "tied",
        num_seed_frames=config.data.num_seed_frames,
        hidden_dim=inferer.hidden_dim,
        layers=inferer.layers,
        dropout=inferer.dropout,
    )
    settings = config.model.discriminator
    return Networks(generator, Discriminator(hidden_dim=settings.hidden_dim, layers=settings.layers))


def _audio_encoder(config: Config) -> AudioEncoder | AsrAudioEncoder:
    audio = config.model.audio
    if audio.kind == "whisper":
        _check_window(config)
        return AsrAudioEncoder(
            whisper=WhisperEncoder(**audio.whisper),
            feature_dim=audio.feature_dim,
            num_frames=config.data.num_frames,
            fps=config.data.fps,
        )
    return AudioEncoder(
        blocks=tuple(audio.blocks),
        channels=tuple(audio.channels),
        stem_stride=tuple(audio.stem_stride),
        feature_dim=audio.feature_dim,
        is_recomputed=config.train.accumulate > 1,
    )


def _check_window(config: Config) -> None:
    data, num_mels = config.data, config.model.audio.whisper.num_mels
    if num_mels != NUM_ASR_MELS:
        raise UserError(
            f"config.model.audio.whisper.num_mels is {num_mels}, expected {NUM_ASR_MELS}: choose a Whisper model other "
            "than large-v3"
        )
    if data.num_frames / data.fps > ASR_COLUMNS / ASR_COLUMNS_PER_SECOND:
        raise UserError(
            f"a window of {data.num_frames} frames at {data.fps} fps is longer than the 2.28 s that a Whisper encoder "
            "hears: set --config.model.audio.kind=resnet_se"
        )


def _identity_encoder(config: Config, num_speakers: int) -> ImageIdentity | SpeakerIdentity:
    identity = config.model.identity
    kind = choice("model.identity.kind", identity.kind, ("images", "speakers"))
    if kind == "speakers":
        return speaker_table(config, num_speakers)
    is_recomputed = config.train.accumulate > 1
    return ImageIdentity(width=identity.width, feature_dim=identity.feature_dim, is_recomputed=is_recomputed)


def _level_channels(levels: tuple[int, ...], skeleton: Skeleton) -> tuple[tuple[int, ...], ...]:
    """The channels of the levels that the pose inferer has a stage for: all, or those that an ablation leaves."""
    numbers = tuple(levels) or tuple(range(1, skeleton.num_levels + 1))
    if list(numbers) != sorted(set(numbers)) or numbers[0] < 1 or numbers[-1] != skeleton.num_levels:
        raise UserError(
            f"config.model.inferer.levels is {numbers}, expected ascending numbers from 1 that end with "
            f"{skeleton.num_levels}, the whole pose"
        )
    return tuple(skeleton.level_channels[number - 1] for number in numbers)


def run(
    task: Task, variables: Variables, batch: Batch, keys: dict[str, jax.Array], *, train: bool = True
) -> tuple[Outputs, tuple[Any, Contrast]]:
    """The generator on one batch, for its own identities and, in the same run, for a permutation of them.

    Audio, text and identity are encoded once, for the whole batch, whose statistics BatchNorm takes. The pose
    inferer treats each clip by itself, so that in training it can take the batch in `task.num_parts` parts.

    Args:
        task: static.
        variables: {"params", "batch_stats"} of the generator.
        batch: as in `train_step`.
        keys: "dropout", "identity" and "permutation".
        train: False is evaluation mode, with the mean of each identity instead of a sample.

    Returns:
        The outputs, and (batch statistics after the run, the run with the other identities).
    """
    speech = {name: batch[name] for name in task.inputs}
    (features, text, (mean, log_variance)), batch_stats = apply(
        task,
        task.generator,
        variables,
        keys["dropout"],
        speech,
        batch[task.identity_input],
        train=train,
        method=_encode,
    )
    f_id = mean
    if train:
        f_id = mean + jnp.exp(0.5 * log_variance) * jax.random.normal(keys["identity"], mean.shape)
    # A turn of the batch: a permutation in which no clip, unless alone, keeps its own identity.
    turn = jax.random.randint(keys["permutation"], (), 1, max(len(mean), 2))
    other_f_id = jax.lax.stop_gradient(jnp.roll(f_id, turn, axis=0))
    seed = subtract_mean(task, batch["directions"])[:, : task.num_seed_frames]

    def infer(key: jax.Array, clips: Any) -> tuple[jax.Array, ...]:
        return _infer_both(task, variables, key, *clips, train=train)

    clips = (tuple(features), f_id, other_f_id, seed)
    if train and task.num_parts > 1:
        pairs = _in_parts(infer, task.num_parts, keys["dropout"], clips)
    else:
        pairs = infer(keys["dropout"], clips)
    outputs = Outputs(tuple(pair[:, 0] for pair in pairs), tuple(features), text, mean, log_variance)
    return outputs, (batch_stats, Contrast(pairs[-1][:, 1], f_id, other_f_id))


def _encode(model: HA2G, speech: dict[str, jax.Array], identity: jax.Array, *, train: bool) -> Any:
    return (
        model.listen(speech, train=train),
        model.encode_text(speech["words"], train=train),
        model.encode_identity(identity, train=train),
    )


def _infer_both(
    task: Task,
    variables: Variables,
    key: jax.Array,
    features: tuple[jax.Array, ...],
    f_id: jax.Array,
    other_f_id: jax.Array,
    seed: jax.Array,
    *,
    train: bool,
) -> tuple[jax.Array, ...]:
    """Per level (B, 2, N, d^h): the poses with the own and with the other identity.

    The two of a clip lie side by side on the batch axis of the pose inferer, so that a batch split over devices
    stays where it is.
    """
    both = jnp.stack([f_id, other_f_id], axis=1).reshape(2 * len(seed), -1)
    *twice, seeds = (jnp.repeat(array, 2, axis=0) for array in (*features, seed))
    levels, _ = apply(task, task.generator, variables, key, tuple(twice), both, seeds, train=train, method="infer")
    return tuple(level.reshape(len(seed), 2, *level.shape[1:]) for level in levels)


def _in_parts(function: Any, count: int, key: jax.Array, clips: Any) -> Any:
    """`function(key, clips)` for one part of the clips after the other.

    What a part has computed on its way is not kept, but computed again when the gradient needs it. Part p has clips
    p, p + count, ...: as the clips of a device lie side by side, it takes as many of each, and none moves.
    """

    def part(_: None, inputs: Any) -> tuple[None, Any]:
        return None, function(*inputs)

    def divide(x: jax.Array) -> jax.Array:
        return jnp.moveaxis(x.reshape(len(x) // count, count, *x.shape[1:]), 1, 0)

    def join(x: jax.Array) -> jax.Array:
        return jnp.moveaxis(x, 0, 1).reshape(-1, *x.shape[2:])

    inputs = (jax.random.split(key, count), jax.tree.map(divide, clips))
    # The loop itself keeps the two passes apart; the barriers that do it elsewhere would only cost.
    return jax.tree.map(join, jax.lax.scan(jax.checkpoint(part, prevent_cse=False), None, inputs)[1])


def loss_terms(task: Task, outputs: Outputs, contrast: Contrast, targets: jax.Array) -> dict[str, jax.Array]:
    """The unweighted terms of Eq. 9 but the adversarial one; `targets` are (B, N, pose_dim), mean-subtracted."""
    skeleton, settings = task.skeleton, task.losses
    angles = joint_angles(skeleton, restore(task, outputs.poses[-1])) / jnp.pi
    levels = tuple(targets[..., jnp.array(channels)] for channels in task.generator.level_channels)
    return {
        "huber": losses.huber(outputs.poses, levels, settings.huber_delta),
        "physical": losses.physical(angles, jnp.asarray(skeleton.angle_mean), jnp.asarray(skeleton.angle_variance)),
        "style": losses.style(outputs.poses[-1], *contrast, delta=settings.huber_delta, clip=settings.style_clip),
        "kld": losses.kld(outputs.mean, outputs.log_variance),
        "contrastive": losses.contrastive(
            outputs.text, *outputs.features, temperature=settings.temperature, negatives=settings.negatives
        ),
    }


METHOD = Method(terms=TERMS, inputs=inputs, build=build, run=run, loss_terms=loss_terms, has_parts=True)
