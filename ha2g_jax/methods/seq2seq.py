"""Attention Seq2Seq (Yoon et al., ICRA 2019): from the words of a window, or from its sound instead, to poses.

In the published comparison, a cubic polynomial for each channel replaced the first 12 frames of each window of a long
recording. Here window borders are treated alike for all methods, see `motion.windows`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.layers import initializers
from ha2g_jax.layers.conv import BatchNorm
from ha2g_jax.layers.gru import BiGRU, GRUCells
from ha2g_jax.layers.linear import Embedding, Linear
from ha2g_jax.layers.resnet_se import AudioEncoder
from ha2g_jax.methods import networks
from ha2g_jax.methods.method import NoSettings, Poses, Spec, generator_arguments, make_spec
from ha2g_jax.methods.networks import identity_encoder, mean_style, resnet_se, speech_features
from ha2g_jax.skeleton import Skeleton

# W [h ; e] is computed as two products, that of the words once for all frames. Both halves are initialised for the
# inputs of both.
_HALF_LINEAR = initializers.linear(0.5**0.5)


class Sentence(NamedTuple):
    """What the decoder reads of the words."""

    words: jax.Array  # (B, T, h) e, one vector for each word in its sentence; 0 after the sentence's end
    states: jax.Array  # (B, layers, h) that the decoder starts from


class SentenceEncoder(nn.Module):
    """A bidirectional GRU over the words of a sentence, or over features of frames instead."""

    num_words: int
    embedding_dim: int
    hidden_dim: int
    layers: int
    dropout: float

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> Sentence:
        """Map word indices (B, T), 0 after the sentence's end, or features (B, T, features) to a sentence.

        The layers of the decoder start from the first entries of the list of final states (layer 1 forward, layer 1
        backward, layer 2 forward, ...): two layers start from both directions of the bottom layer. The top layer would
        be the natural choice; we follow the published comparisons.
        """
        is_real = None
        if x.ndim == 2:  # words
            is_real = x != 0
            spread = initializers.normal(self.embedding_dim**-0.5)
            x = Embedding(self.num_words, self.embedding_dim, embedding_init=spread, name="embedding")(x)
        gru = BiGRU(self.hidden_dim, self.layers, self.dropout, name="gru")
        states = gru.states(x, is_real=is_real, train=train)
        forward, backward = states[-1]
        words = forward + backward
        final = [state for forward, backward in states for state in (forward[:, -1], backward[:, 0])]
        return Sentence(
            words=words if is_real is None else jnp.where(is_real[..., None], words, 0),
            states=jnp.stack(final[: self.layers], axis=1),
        )


class PoseDecoder(nn.Module):
    """One step of the decoder: attention to the words, then a GRU that goes from one pose to the next."""

    pose_dim: int
    hidden_dim: int
    layers: int
    dropout: float

    @nn.compact
    def __call__(
        self, states: tuple[jax.Array, ...], pose: jax.Array, words: jax.Array, keys: jax.Array, *, train: bool
    ) -> tuple[tuple[jax.Array, ...], jax.Array]:
        """Return the states after this step, and the pose (B, pose_dim) of this frame.

        Attention is additive (Bahdanau et al. 2015),

            context = sum_i softmax_i(v . tanh(W [h ; e_i] + b)) e_i

        where h is the top state and i runs over all T steps. Steps after the sentence's end are zero vectors but have
        a share of the weight, as in the published comparisons.

        Args:
            states: of the frame before, for each layer (B, hidden_dim).
            pose: of the frame before (B, pose_dim), followed by the style if there is one.
            words: e (B, T, hidden_dim).
            keys: the part of W [h ; e] that depends on e.
            train: whether to run in training mode.
        """
        attend = nn.Dense(self.hidden_dim, kernel_init=_HALF_LINEAR, name="attention_state")
        query = attend(states[-1].astype(pose.dtype))
        vector = self.param("attention_vector", initializers.normal(self.hidden_dim**-0.5), (self.hidden_dim,))
        scores = jnp.tanh(query[:, None] + keys) @ vector
        weights = nn.softmax(scores.astype(jnp.float32), axis=-1).astype(words.dtype)
        context = jnp.einsum("bt,bth->bh", weights, words)

        x = jnp.concatenate([pose, context], axis=-1)
        x = Linear(self.hidden_dim, name="linear_in")(x)
        x = nn.relu(BatchNorm(name="norm")(x, train=train))
        states = GRUCells(self.hidden_dim, self.layers, self.dropout, name="gru")(states, x, train=train)
        output = Linear(self.pose_dim, name="linear_out")
        return states, output(states[-1].astype(x.dtype))


class Seq2Seq(nn.Module):
    """Generator from the words of a window, without their times, or its sound, and M seed poses to N poses.

    The style is the mean of the identity. Poses are flat, mean-subtracted direction vectors (D1). All methods use
    "batch_stats", except `encode_speech` with words; it and `infer` draw from the stream "dropout" in training.
    """

    num_words: int
    pose_dim: int
    num_frames: int = 34
    embedding_dim: int = 300
    hidden_dim: int = 200
    layers: int = 2
    dropout: float = 0.1
    audio: AudioEncoder | None = None  # None for a model that reads the words
    identity: Any = None  # encoder of images, None for a model without identities

    def setup(self) -> None:
        self.text = SentenceEncoder(self.num_words, self.embedding_dim, self.hidden_dim, self.layers, self.dropout)
        self.attention_words = nn.Dense(self.hidden_dim, use_bias=False, kernel_init=_HALF_LINEAR)
        self.decoder = PoseDecoder(self.pose_dim, self.hidden_dim, self.layers, self.dropout)

    def __call__(
        self, inputs: dict[str, jax.Array], identity: jax.Array | None, seed_pose: jax.Array, *, train: bool
    ) -> tuple[jax.Array]:
        """Run every part once and return the poses of `infer`."""
        style = mean_style(self, identity, seed_pose, train=train)
        return self.infer(self.encode_speech(inputs, train=train), style, seed_pose, train=train)

    def encode_speech(self, inputs: dict[str, jax.Array], *, train: bool) -> Sentence:
        """Map "plain_words" (B, T), word indices padded with 0, or "mel" (B, 128, 70) in dB to a sentence."""
        if self.audio is None:
            return self.text(inputs["plain_words"], train=train)
        return self.text(speech_features(self.audio, None, inputs, train=train), train=train)

    def encode_identity(self, images: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map images (B, M, S, S, 3) to mean and log-variance of the style, each (B, style_dim)."""
        return self.identity(images, train=train)

    def infer(self, sentence: Sentence, style: jax.Array, seed_pose: jax.Array, *, train: bool) -> tuple[jax.Array]:
        """Decode frame by frame, in training as in synthesis, from the true poses (B, M, pose_dim) of the first M
        frames, in a style (B, style_dim).

        Frame 0 is copied from the seed. Frame t is decoded from the true pose t - 1 while t - 1 < M, then from the
        decoded pose t - 1. BatchNorm normalises each frame by itself; its running averages are over all frames. The
        result is one level (B, N, pose_dim).
        """
        words, states = sentence
        keys = self.attention_words(words)
        num_free = self.num_frames - 1 - seed_pose.shape[1]
        known = jnp.pad(jnp.swapaxes(seed_pose, 0, 1), ((0, num_free), (0, 0), (0, 0)))
        is_known = (jnp.arange(self.num_frames - 1) < seed_pose.shape[1])[:, None, None]

        def step(decoder, carry, frame):
            states, previous = carry
            known, is_known = frame
            pose = jnp.concatenate([jnp.where(is_known, known, previous), style], axis=-1)
            states, pose = decoder(states, pose, words, keys, train=train)
            return (states, pose), pose

        start = (tuple(jnp.moveaxis(states.astype(jnp.float32), 1, 0)), known[0])
        if self.is_initializing():  # a scan cannot carry statistics that do not exist yet
            step(self.decoder, start, (known[0], is_known[0]))
        # The scan carries the statistics in training, where they change; in evaluation they are constants.
        carried, fixed = (["batch_stats"], []) if self.is_mutable_collection("batch_stats") else ([], ["batch_stats"])
        scan = nn.scan(
            step,
            variable_broadcast=["params", *fixed],
            variable_carry=carried,
            split_rngs={"params": False, "dropout": True},
        )
        _, poses = scan(self.decoder, start, (known, is_known))
        return (jnp.concatenate([seed_pose[:, :1], jnp.swapaxes(poses, 0, 1)], axis=1),)


# Squared norm below which the gradient is 0, because a square root has none at 0, where a value never moves.
_MIN_SQUARE = 1e-12


def mse(poses: jax.Array, targets: jax.Array) -> jax.Array:
    """Return the mean squared error over batch, frames and dimensions of mean-subtracted poses (B, N, pose_dim)."""
    return jnp.mean(jnp.square(poses - targets))


def continuity(poses: jax.Array) -> jax.Array:
    """Return the change of poses (B, N, pose_dim) from frame to frame: sum |y_t - y_(t-1)| / (B N pose_dim)."""
    return jnp.sum(jnp.abs(poses[:, 1:] - poses[:, :-1])) / poses.size


def variance(poses: jax.Array) -> jax.Array:
    """Return the negative spread of poses y (B, N, pose_dim): - sum_(b, d) ||y_(b, :, d)||_2 / (B N pose_dim).

    The poses are mean-subtracted, and the norm is taken along time.
    """
    square = jnp.sum(jnp.square(poses), axis=1)
    return -jnp.sum(jnp.sqrt(jnp.maximum(square, _MIN_SQUARE))) / poses.size


rngs: tuple[str, ...] = ("dropout",)
reconstruction_term = "mse"
has_parts = False
init_arguments = generator_arguments
run, LossSettings = networks.run, NoSettings
encode_speech, encode_identity, sample = networks.encode_speech, networks.encode_identity, networks.sample


class Terms(NamedTuple):
    """Terms of the objective, each an unweighted scalar (), or their weights as floats."""

    mse: jax.Array
    continuity: jax.Array
    variance: jax.Array


# The tokens of a sentence's start and end, whose indices follow those of the vocabulary.
_NUM_MARKS = 2


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Spec:
    """Build the network of `config.model`; there is no discriminator. See `Method.build`.

    Raises:
        UserError: the config selects both words and sound for the sentence, or neither.
    """
    inferer, text, sound = config.model.inferer, config.model.text.kind, config.model.audio.kind
    if (text == "none") != (sound == "resnet_se"):
        raise UserError(
            f"config.model.text.kind is {text!r} and config.model.audio.kind {sound!r}: set them to 'tcn' and 'none', "
            "or to 'none' and 'resnet_se' to hear the sound in place of the words"
        )
    audio = None if sound == "none" else resnet_se(config)
    generator = Seq2Seq(
        num_words=vocabulary_size + _NUM_MARKS,
        pose_dim=skeleton.pose_dim,
        num_frames=config.data.num_frames,
        embedding_dim=config.model.text.embedding_dim,
        hidden_dim=inferer.hidden_dim,
        layers=inferer.layers,
        dropout=inferer.dropout,
        audio=audio,
        identity=identity_encoder(config, num_speakers),
    )
    return make_spec(config, skeleton, generator, inputs=("plain_words",) if audio is None else audio.inputs)


def terms(spec: Spec, settings: NoSettings, outputs: Poses, constants: None, targets: jax.Array, gan: None) -> Terms:
    """Return the unweighted terms; see `Method.terms`."""
    del spec, settings, constants, gan
    (poses,) = outputs.poses
    return Terms(mse(poses, targets), continuity(poses), variance(poses))
