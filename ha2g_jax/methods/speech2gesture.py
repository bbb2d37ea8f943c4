"""Speech2Gesture (Ginosar et al., CVPR 2019): from a spectrogram to poses, with a discriminator of motion.

Arrays have the channels last. "SAME" padding is that of XLA and TensorFlow: an odd remainder goes to the right and the
bottom.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.features.spectrum import NUM_MELS, window_columns
from ha2g_jax.layers import initializers
from ha2g_jax.layers.conv import BatchNorm
from ha2g_jax.layers.linear import Linear
from ha2g_jax.layers.resnet_se import MEL_RANGE
from ha2g_jax.methods import networks
from ha2g_jax.methods.method import NoSettings, Poses, Spec, generator_arguments, make_spec
from ha2g_jax.methods.networks import identity_encoder, mean_style
from ha2g_jax.skeleton import Skeleton

_SLOPE = 0.2
_SEED_HIDDEN_DIM = 32
_SEED_DIM = 16
_VALID_KERNEL = 3  # of the last convolution on the spectrogram, which is not padded


class Block(nn.Module):
    """Convolution, BatchNorm and LeakyReLU 0.2, with "SAME" or "VALID" padding; a stride of 2 makes a "down" block."""

    channels: int
    kernel: tuple[int, ...]
    stride: int = 1
    padding: str = "SAME"

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (B, *space, inputs) to (B, *space / stride, channels), rounded up."""
        x = _conv(self.channels, self.kernel, self.stride, self.padding, name="conv")(x)
        return nn.leaky_relu(BatchNorm(name="norm")(x, train=train), _SLOPE)


def _conv(channels: int, kernel: tuple[int, ...], stride: int = 1, padding: str = "SAME", *, name: str) -> nn.Conv:
    strides = (stride,) * len(kernel)
    return nn.Conv(channels, kernel, strides, padding, kernel_init=initializers.LINEAR, name=name)


def lay_on_frames(x: jax.Array, num_frames: int, *, swapped: bool = False) -> jax.Array:
    """Resize (B, frequencies, times, channels) to (B, N, channels), bilinearly and without aligned corners.

    Time is resampled to frames, as in the original work, and the two middle frequencies are averaged. If `swapped`, as
    in the code of HA2G's authors, frequency is resampled to frames instead, so that all frames hear the middle moment.
    """
    if swapped:
        x = jnp.swapaxes(x, 1, 2)
    shape = (len(x), 1, num_frames, x.shape[-1])
    return jax.image.resize(x, shape, "bilinear", antialias=False)[:, 0]


class SpectrogramEncoder(nn.Module):
    """The two-dimensional part: each stage halves both axes of the spectrogram, then time is resampled to frames."""

    channels: tuple[int, ...]
    num_frames: int
    swapped_axes: bool

    @nn.compact
    def __call__(self, mel: jax.Array, *, train: bool) -> jax.Array:
        """Map the mel (B, 128, 70) in dB, -80 to 0, to (B, N, channels[-1])."""
        x = (mel / MEL_RANGE + 1)[..., None]  # D3
        for index, channels in enumerate(self.channels):
            x = Block(channels, (3, 3), name=f"block_{index}")(x, train=train)
            x = Block(channels, (4, 4), stride=2, name=f"down_{index}")(x, train=train)
        x = Block(self.channels[-1], (3, 3), name="block_same")(x, train=train)
        x = Block(self.channels[-1], (_VALID_KERNEL, _VALID_KERNEL), padding="VALID", name="block_valid")(
            x, train=train
        )
        return lay_on_frames(x, self.num_frames, swapped=self.swapped_axes)


class UNet(nn.Module):
    """The one-dimensional part: frames are halved `downs` times and doubled again, with additive skip connections."""

    channels: int
    downs: int

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (B, N, inputs) to (B, N, channels)."""
        for index in range(2):
            x = Block(self.channels, (3,), name=f"block_{index}")(x, train=train)
        skips = []
        for index in range(self.downs):
            skips.append(x)
            x = Block(self.channels, (4,), stride=2, name=f"down_{index}")(x, train=train)
        for index, skip in enumerate(reversed(skips)):
            x = jnp.repeat(x, 2, axis=1)[:, : skip.shape[1]] + skip
            x = Block(self.channels, (3,), name=f"up_{index}")(x, train=train)
        return x


class Speech2Gesture(nn.Module):
    """Generator from the mel of a window and M seed poses to N poses.

    It reads no words, and the style is the mean of the identity. Poses are flat, mean-subtracted direction vectors
    (D1). All methods use "batch_stats". The stages on the spectrogram have `audio_channels`, the blocks on frames
    `channels`; for `swapped_axes` see `lay_on_frames`.
    """

    pose_dim: int
    num_frames: int = 34
    audio_channels: tuple[int, ...] = (64, 128, 256)
    channels: int = 256
    downs: int = 5
    swapped_axes: bool = False
    identity: Any = None  # encoder of images, None for a model without identities

    def setup(self) -> None:
        self.audio = SpectrogramEncoder(self.audio_channels, self.num_frames, self.swapped_axes)
        self.unet = UNet(self.channels, self.downs)
        self.seed_in = Linear(_SEED_HIDDEN_DIM)
        self.seed_norm = BatchNorm()
        self.seed_out = Linear(_SEED_DIM)
        self.decoder = [Block(self.channels, (3,)) for _ in range(4)]
        self.output = nn.Conv(self.pose_dim, (1,), kernel_init=initializers.LINEAR)

    def __call__(
        self, inputs: dict[str, jax.Array], identity: jax.Array | None, seed_pose: jax.Array, *, train: bool
    ) -> tuple[jax.Array]:
        """Run every part once and return the poses of `infer`."""
        style = mean_style(self, identity, seed_pose, train=train)
        return self.infer(self.encode_speech(inputs, train=train), style, seed_pose, train=train)

    def encode_speech(self, inputs: dict[str, jax.Array], *, train: bool) -> jax.Array:
        """Map "mel" (B, 128, 70) in dB to features on frames (B, N, channels)."""
        return self.unet(self.audio(inputs["mel"], train=train), train=train)

    def encode_identity(self, images: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map images (B, M, S, S, 3) to mean and log-variance of the style, each (B, style_dim)."""
        return self.identity(images, train=train)

    def infer(self, features: jax.Array, style: jax.Array, seed_pose: jax.Array, *, train: bool) -> tuple[jax.Array]:
        """Decode features (B, N, channels), a style (B, style_dim) and the true poses (B, M, pose_dim) of the first M
        frames.

        The result is one level (B, N, pose_dim), in which the seed frames are predicted as well.
        """
        start = nn.relu(self.seed_norm(self.seed_in(seed_pose.reshape(len(seed_pose), -1)), train=train))
        start = jnp.concatenate([self.seed_out(start), style], axis=-1)
        start = jnp.repeat(start[:, None], features.shape[1], axis=1)
        x = jnp.concatenate([features, start], axis=-1)
        for block in self.decoder:
            x = block(x, train=train)
        return (self.output(x),)


class PatchDiscriminator(nn.Module):
    """Discriminator of motion, the differences between frames, with one score for each patch of frames.

    34 poses become 33 differences, 17, 9, 9 and 9 scores.

    Attributes:
        channels: channels of the first convolution; the next two have twice and four times as many.
        differences: order of the differences; the authors of HA2G took 2, which gives 8 scores.
    """

    channels: int = 64
    differences: int = 1

    @nn.compact
    def __call__(self, poses: jax.Array, *, train: bool) -> jax.Array:
        """Map mean-subtracted poses (B, N, pose_dim) to scores (B, patches), for a least-squares loss."""
        x = jnp.diff(poses, self.differences, axis=1)
        x = nn.leaky_relu(_conv(self.channels, (4,), stride=2, name="conv_in")(x), _SLOPE)
        x = Block(2 * self.channels, (4,), stride=2, name="down")(x, train=train)
        x = Block(4 * self.channels, (4,), name="block")(x, train=train)
        return _conv(1, (4,), name="conv_out")(x)[..., 0]


def l1(poses: jax.Array, targets: jax.Array) -> jax.Array:
    """Return the mean absolute error over batch, frames and dimensions of mean-subtracted poses (B, N, pose_dim)."""
    return jnp.mean(jnp.abs(poses - targets))


rngs: tuple[str, ...] = ("dropout",)
reconstruction_term = "l1"
has_parts = False
init_arguments = generator_arguments
run, LossSettings = networks.run, NoSettings
encode_speech, encode_identity, sample = networks.encode_speech, networks.encode_identity, networks.sample


class Terms(NamedTuple):
    """Terms of the objective, each an unweighted scalar (), or their weights as floats."""

    l1: jax.Array
    gan: jax.Array


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Spec:
    """Build the networks of `config.model`; see `Method.build`.

    `config.model.legacy` builds them as the authors of HA2G compared with them: with as many parameters, but the axes
    of time and frequency are swapped and the discriminator sees second differences.

    Raises:
        UserError: there are more stages than the spectrogram of a window can be halved.
    """
    del vocabulary_size
    legacy = config.model.legacy
    _check_stages(config)
    generator = Speech2Gesture(
        pose_dim=skeleton.pose_dim,
        num_frames=config.data.num_frames,
        audio_channels=tuple(config.model.audio.spectrogram.channels),
        channels=config.model.inferer.hidden_dim,
        downs=config.model.inferer.layers,
        swapped_axes=legacy,
        identity=identity_encoder(config, num_speakers),
    )
    discriminator = PatchDiscriminator(config.model.discriminator.hidden_dim, differences=2 if legacy else 1)
    return make_spec(config, skeleton, generator, discriminator, inputs=("mel",))


def _check_stages(config: Config) -> None:
    """Check that the spectrogram after its stages is large enough for the convolution that follows."""
    sides = (NUM_MELS, window_columns(config.data.num_frames, config.data.fps))
    stages = len(config.model.audio.spectrogram.channels)
    if min(-(-side // 2**stages) for side in sides) < _VALID_KERNEL:
        raise UserError(
            f"config.model.audio.spectrogram.channels has {stages} stages, each of which halves a spectrogram of "
            f"{sides[0]} x {sides[1]}: set fewer"
        )


def terms(
    spec: Spec, settings: NoSettings, outputs: Poses, constants: None, targets: jax.Array, gan: jax.Array
) -> Terms:
    """Return the unweighted terms; see `Method.terms`."""
    del spec, settings, constants
    return Terms(l1(outputs.poses[-1], targets), gan)
