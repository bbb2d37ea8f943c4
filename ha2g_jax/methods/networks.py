"""What several methods share: encoders, and a function that runs a network in the precision of a training step.

Parameters are float32 everywhere outside of the modules. When a module runs, they and the inputs are rounded to
`Compute.dtype` and the results are converted back to float32, so that gradients, statistics and losses are float32 too.
"""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.config.settings import Config
from ha2g_jax.features.noise import track
from ha2g_jax.layers.cpu.onednn.library import choosing
from ha2g_jax.layers.identity import ImageIdentity, SpeakerIdentity
from ha2g_jax.layers.resnet_se import AudioEncoder, Features
from ha2g_jax.layers.tcn import TextEncoder
from ha2g_jax.layers.waveform import WaveformEncoder
from ha2g_jax.methods.method import FLOAT32, Batch, Compute, Poses, Run, Spec, Variables, generator_arguments

_NOISE_FRAMES = 1 << 10  # training noise starts at one of these; they span more than one period of it at any frame rate


def text_encoder(config: Config, vocabulary_size: int) -> TextEncoder:
    """Return E_t, whose features have as many channels as those of the audio."""
    text = config.model.text
    return TextEncoder(
        vocabulary_size=vocabulary_size,
        embedding_dim=text.embedding_dim,
        channels=text.channels,
        layers=text.layers,
        feature_dim=config.model.audio.feature_dim,
        receptive_field=text.receptive_field,
        dropout=text.dropout,
    )


def audio_encoder(config: Config) -> AudioEncoder | WaveformEncoder:
    """Return E_a, or the encoder of the waveform of a window."""
    if config.model.audio.kind == "resnet_se":
        return resnet_se(config)
    data = config.data
    return WaveformEncoder(config.model.audio.feature_dim, num_frames=data.num_frames, fps=data.fps)


def resnet_se(config: Config, *, reads_decibels: bool = False) -> AudioEncoder:
    """Return E_a."""
    audio, data = config.model.audio, config.data
    settings: dict[str, Any] = {name: tuple(value) for name, value in audio.resnet_se.items()}
    return AudioEncoder(
        **settings,
        feature_dim=audio.feature_dim,
        num_frames=data.num_frames,
        fps=data.fps,
        is_recomputed=config.model.recompute,
        reads_decibels=reads_decibels,
    )


def identity_encoder(config: Config, num_speakers: int, *, has_hidden: bool = False) -> Any:
    """Return E_ID, an `ImageIdentity` or a `SpeakerIdentity`; None for a method without identities."""
    identity = config.model.identity
    if identity.kind == "none":
        return None
    if identity.kind == "speakers":
        return speaker_table(config, num_speakers, has_hidden=has_hidden)
    return ImageIdentity(
        blocks=tuple(identity.images.blocks),
        width=identity.images.width,
        feature_dim=identity.feature_dim,
        is_recomputed=config.model.recompute,
    )


def speaker_table(config: Config, num_speakers: int, *, has_hidden: bool = False) -> SpeakerIdentity:
    """Return a table of the speakers; if windows are mirrored, it has twice as many rows, for their mirror images."""
    return SpeakerIdentity(
        num_speakers=2 * num_speakers if config.data.mirror else num_speakers,
        feature_dim=config.model.identity.feature_dim,
        has_hidden=has_hidden,
    )


def speech_features(audio: Any, text: TextEncoder | None, inputs: Mapping[str, jax.Array], *, train: bool) -> jax.Array:
    """Return the features of the sound and, with a text encoder, of the words, side by side: (B, N, features).

    `audio` returns one array, or `Features`, which are taken in their order low, mid, high.
    """
    (name,) = audio.inputs
    sound = audio(inputs[name], train=train)
    parts = [*sound] if isinstance(sound, Features) else [sound]
    if text is not None:
        parts.append(text(inputs["words"], train=train))
    return jnp.concatenate(parts, axis=-1)


def mean_style(generator: Any, identity: jax.Array | None, seed_pose: jax.Array, *, train: bool) -> jax.Array:
    """Return the mean styles (B, style_dim) that a bound generator encodes; (B, 0) without identities."""
    return seed_pose[:, 0, :0] if identity is None else generator.encode_identity(identity, train=train)[0]


def encode_speech(spec: Spec, variables: Variables, speech: Batch) -> Any:
    """Encode the speech of windows with the generator's method of this name; see `GeneratingMethod`."""
    return spec.generator.apply(variables, speech, train=False, method="encode_speech")


def encode_identity(spec: Spec, variables: Variables, identity: jax.Array) -> jax.Array:
    """Encode images or speaker indices to the mean of their styles, (B, style_dim); see `GeneratingMethod`."""
    mean, _ = spec.generator.apply(variables, identity, train=False, method="encode_identity")
    return mean


def sample(
    spec: Spec, variables: Variables, features: Any, style: jax.Array, seed_pose: jax.Array, noise: jax.Array
) -> jax.Array:
    """Generate the poses of windows, the last level of the generator, without noise; see `GeneratingMethod`."""
    del noise
    return spec.generator.apply(variables, features, style, seed_pose, train=False, method="infer")[-1]


def draw_noise(spec: Spec, key: jax.Array, count: int) -> jax.Array:
    """Draw the noise (count, N, noise_dim) of training windows, each with a random seed and start."""
    seed_key, moment_key = jax.random.split(key)
    seeds = jax.random.bits(seed_key, (count,), jnp.uint32)
    moments = jax.random.randint(moment_key, (count, 1), 0, _NOISE_FRAMES)
    return track(seeds, moments + jnp.arange(spec.num_frames)[None], spec.fps, spec.noise_dim)


def apply(
    module: nn.Module,
    variables: Variables,
    key: jax.Array,
    *args: Any,
    train: bool,
    compute: Compute,
    method: Any = None,
) -> tuple[Any, Any]:
    """Run a module of a spec, or one of its methods.

    With `train` the module runs in training mode, which updates the batch statistics; `key` is that of the random
    stream "dropout". `method` is the name of a method of the module, by default `__call__`, or a function of the bound
    module. Returns the result in float32, and the batch statistics after this run.
    """
    rounded = variables | {"params": _cast(variables["params"], compute.dtype)}
    with choosing(compute.onednn):
        result, updates = module.apply(
            rounded,
            *_cast(args, compute.dtype),
            mutable=["batch_stats"] if train else [],
            rngs={"dropout": key},
            train=train,
            method=method,
        )
    return _cast(result, jnp.dtype(jnp.float32)), updates.get("batch_stats", variables["batch_stats"])


def infer_both(
    spec: Spec,
    variables: Variables,
    key: jax.Array,
    features: Any,
    style: jax.Array,
    other_style: jax.Array,
    seed_pose: jax.Array,
    *,
    train: bool,
    compute: Compute,
) -> tuple[tuple[jax.Array, ...], jax.Array]:
    """Return the poses of each level with a clip's own style, (B, N, d^h), and the last level with the other one.

    The gradient of the style term reaches only the poses with the clip's own style. The other poses are therefore
    computed in a second run without a gradient, which costs less than one run with a gradient on twice the batch.
    """

    def infer(variables: Variables, key: jax.Array, *clips: Any) -> tuple[jax.Array, ...]:
        return apply(spec.generator, variables, key, *clips, train=train, compute=compute, method="infer")[0]

    own_key, other_key = jax.random.split(key)
    own = infer(variables, own_key, features, style, seed_pose)
    other = infer(*jax.lax.stop_gradient((variables, other_key, features, other_style, seed_pose)))
    return own, other[-1]


def run(
    spec: Spec,
    variables: Variables,
    batch: Batch,
    keys: dict[str, jax.Array],
    *,
    train: bool = True,
    compute: Compute = FLOAT32,
) -> Run[Poses, None]:
    """Run a generator that needs nothing but a call on a batch; see `Method.run`."""
    arguments = generator_arguments(spec, batch)
    poses, batch_stats = apply(spec.generator, variables, keys["dropout"], *arguments, train=train, compute=compute)
    return Run(Poses(poses), None, batch_stats)


def _cast(tree: Any, dtype: jnp.dtype) -> Any:
    """Return floats and pixels (bytes) as `dtype`; bfloat16 holds every byte exactly. Indices are left as they are."""

    def cast(x: jax.Array) -> jax.Array:
        return x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) or x.dtype == jnp.uint8 else x

    return jax.tree.map(cast, tree)
