"""The interface between a method and the rest of the package: what generation, training and storage need from it.

A method is a module of this package whose functions have the names and arguments of `Method`, and of
`GeneratingMethod` if it generates motion from speech. `ha2g_jax.methods.METHODS` lists them by name. `Spec` holds
everything that generation needs; weights of losses, optimisers and schedules are in `ha2g_jax.train.objective`.
"""

from collections.abc import Mapping
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.config.settings import Config
from ha2g_jax.features.audio import window_samples
from ha2g_jax.features.spectrum import NUM_ASR_MELS, NUM_MELS, asr_columns, window_columns
from ha2g_jax.features.text import MAX_PLAIN_WORDS
from ha2g_jax.motion.windows import window_stride
from ha2g_jax.skeleton import Skeleton, normalize

Batch = Mapping[str, Any]
Variables = dict[str, Any]  # {"params", "batch_stats"} of a network
Outputs = TypeVar("Outputs")
Constants = TypeVar("Constants")

# The batch key that identities are read from, for each kind of `config.model.identity`.
IDENTITIES = {"images": "images", "speakers": "speaker", "none": ""}


class Spec(NamedTuple):
    """The networks of a model and their sizes. Equal specs are equal static arguments of `jax.jit`.

    Attributes:
        method: name in `ha2g_jax.methods.TRAINABLE`.
        generator: network from speech, identity and seed poses to poses; that of the auto-encoder maps poses to poses.
        discriminator: network of the adversarial loss, None for a method without one.
        skeleton: skeleton with the statistics of the training split.
        num_frames, num_seed_frames: frames of a window, N, and of the seed pose, M.
        fps: frames per second.
        inputs: names of the speech inputs of `encode_speech`, as in `ha2g_jax.data.speech`.
        training_inputs: names of the speech inputs of a training example.
        identity: batch key that identities are read from, "images" or "speaker"; "" for a method without identities.
        style_dim: number of values of a style, 0 for a method without identities.
        num_reference_images, image_size: images of an identity, and their height and width in pixels.
        noise_dim: channels of the noise that `GeneratingMethod.sample` reads, 0 for a method without noise.
    """

    method: str
    generator: Any
    discriminator: Any
    skeleton: Skeleton
    num_frames: int
    num_seed_frames: int
    fps: int
    inputs: tuple[str, ...]
    training_inputs: tuple[str, ...]
    identity: str
    style_dim: int
    num_reference_images: int
    image_size: int
    noise_dim: int = 0

    @property
    def window_stride(self) -> int:
        """Number of frames from the start of one window of a recording to the start of the next."""
        return window_stride(self.num_frames, self.num_seed_frames)

    def __repr__(self) -> str:
        window = f"{self.num_frames} frames, {self.num_seed_frames} of them given"
        return f"Spec({self.method!r}, {self.skeleton.name}, {self.fps} fps, {window})"


class Compute(NamedTuple):
    """How a training step computes the networks, which changes its memory and speed but not its objective.

    Attributes:
        dtype: type of the activations. Parameters, statistics and losses are float32 in any case.
        num_parts: parts of the batch that go through the pose inferer one after the other.
        onednn: whether oneDNN computes convolutions and GRUs on a CPU, see `ha2g_jax.layers.cpu`.
    """

    dtype: Any = jnp.dtype(jnp.float32)
    num_parts: int = 1
    onednn: bool = False


FLOAT32 = Compute()


class Run(NamedTuple, Generic[Outputs, Constants]):
    """The generator on a training batch.

    Attributes:
        outputs: a NamedTuple that gradients flow through; each array of its field `poses` is mean-subtracted, and the
            last one is (B, N, pose_dim).
        constants: a NamedTuple of the other arrays that the terms need, without a gradient; None if they need none.
        batch_stats: BatchNorm statistics of the generator after this batch.
    """

    outputs: Outputs
    constants: Constants
    batch_stats: Any


class Poses(NamedTuple):
    """Outputs of a method whose objective uses only the poses: one level, (B, N, pose_dim), mean-subtracted."""

    poses: tuple[jax.Array]


class NoSettings(NamedTuple):
    """`Method.LossSettings` of a method whose terms have none."""


class Method(Protocol):
    """Functions that training calls; the pose auto-encoder of the Frechet gesture distance has only these.

    Attributes:
        rngs: names of the random streams of `run`.
        Terms: NamedTuple of the terms of the objective, or of their weights; it has a field `gan` if and only if there
            is a discriminator.
        LossSettings: NamedTuple of the settings of the terms, `config.loss.<method>` without weights and kind of GAN.
        reconstruction_term: name of the term that measures the error of the poses.
        has_parts: whether `run` can process the batch in `Compute.num_parts` parts.
    """

    rngs: tuple[str, ...]
    Terms: Any
    LossSettings: Any
    reconstruction_term: str
    has_parts: bool

    def build(self, config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Spec:
        """Build the networks that `config.model` and `config.data` describe, see `ha2g_jax.methods.build`.

        Raises:
            UserError: a setting that the method cannot use.
        """
        ...

    def init_arguments(self, spec: Spec, batch: Batch) -> tuple[Any, ...]:
        """Return arguments of `spec.generator` with which every part of it runs once, to initialise it."""
        ...

    def run(
        self,
        spec: Spec,
        variables: Variables,
        batch: Batch,
        keys: dict[str, jax.Array],
        *,
        train: bool = True,
        compute: Compute = FLOAT32,
    ) -> Run[Any, Any]:
        """Run the generator on a training batch, in training or evaluation mode, in the precision and parts of
        `compute`.

        The batch has arrays as in `ha2g_jax.train.step.train_step`; `keys` has a key for each name in `Method.rngs`.
        """
        ...

    def terms(self, spec: Spec, settings: Any, outputs: Any, constants: Any, targets: jax.Array, gan: Any) -> Any:
        """Return the unweighted `Terms` of the objective.

        The targets are the true poses (B, N, pose_dim), mean-subtracted. `gan` is the value () of the adversarial term;
        None for a method without a discriminator.
        """
        ...


class GeneratingMethod(Method, Protocol):
    """Functions of a method that generates motion from speech; generation calls only these."""

    def encode_speech(self, spec: Spec, variables: Variables, speech: Batch) -> Any:
        """Encode the speech of B windows, given as arrays (B, ...) under the names in `spec.inputs`.

        The features are a tree of arrays (B, ...).
        """
        ...

    def encode_identity(self, spec: Spec, variables: Variables, identity: jax.Array) -> jax.Array:
        """Encode identities: images (B, num_images, S, S, 3) or speaker indices (B,) to styles (B, style_dim).

        Generation calls it only where `spec.identity` is not empty.
        """
        ...

    def sample(
        self, spec: Spec, variables: Variables, features: Any, style: jax.Array, seed_pose: jax.Array, noise: jax.Array
    ) -> jax.Array:
        """Generate the poses (B, N, pose_dim) of B windows, mean-subtracted, from the result of `encode_speech`.

        Styles are (B, style_dim); seed poses (B, M, pose_dim) are those of the first M frames, mean-subtracted; the
        noise (B, N, noise_dim) is that of `features.noise.track`.
        """
        ...


def total(weights: Any, terms: Any) -> jax.Array:
    """Return the objective (HA2G, Eq. 9): each of the `Terms` times its weight, summed in the order of the fields."""
    return sum((weight * term for weight, term in zip(weights, terms, strict=True)), start=jnp.zeros((), jnp.float32))


def make_spec(
    config: Config,
    skeleton: Skeleton,
    generator: nn.Module,
    discriminator: nn.Module | None = None,
    *,
    inputs: tuple[str, ...],
    training_inputs: tuple[str, ...] | None = None,
    noise_dim: int = 0,
) -> Spec:
    """Return the spec of networks that a method has built, with the sizes in `config.data`.

    By default `training_inputs` are `inputs`.
    """
    identity = config.model.identity
    return Spec(
        method=config.method,
        generator=generator,
        discriminator=discriminator,
        skeleton=skeleton,
        num_frames=config.data.num_frames,
        num_seed_frames=config.data.num_seed_frames,
        fps=config.data.fps,
        inputs=inputs,
        training_inputs=inputs if training_inputs is None else training_inputs,
        identity=IDENTITIES[identity.kind],
        style_dim=0 if identity.kind == "none" else identity.feature_dim,
        num_reference_images=config.data.num_reference_images,
        image_size=config.data.image_size,
        noise_dim=noise_dim,
    )


def generator_arguments(spec: Spec, batch: Batch) -> tuple[Any, ...]:
    """Return the arguments of a generator called with the speech, the identities and the seed poses of a batch."""
    speech = {name: batch[name] for name in spec.training_inputs}
    seed_pose = subtract_mean(spec, batch["directions"])[:, : spec.num_seed_frames]
    return speech, batch[spec.identity] if spec.identity else None, seed_pose


def subtract_mean(spec: Spec, directions: jax.Array) -> jax.Array:
    """Return direction vectors (..., bones, 3) minus their mean, flat (..., pose_dim), as networks read them (D1)."""
    mean = jnp.asarray(spec.skeleton.mean_directions, jnp.float32)
    centred = directions - jnp.expand_dims(mean, tuple(range(directions.ndim - 2)))
    return centred.astype(jnp.float32).reshape(*directions.shape[:-2], spec.skeleton.pose_dim)


def restore(spec: Spec, poses: jax.Array) -> jax.Array:
    """Add the mean to flat poses (..., pose_dim) and return unit vectors (..., bones, 3), the inverse of D1."""
    mean = jnp.asarray(spec.skeleton.mean_directions, jnp.float32)
    vectors = poses.reshape(*poses.shape[:-1], spec.skeleton.num_bones, 3)
    return normalize(vectors + jnp.expand_dims(mean, tuple(range(vectors.ndim - 2))))


def example_batch(spec: Spec) -> Batch:
    """Return a batch of one empty window with the shapes of a real one."""
    window = (spec.num_frames, spec.fps)
    shapes = {
        "mel": ((1, NUM_MELS, window_columns(*window)), jnp.float32),
        "asr_mel": ((1, NUM_ASR_MELS, asr_columns(*window)), jnp.float32),
        "audio": ((1, window_samples(*window)), jnp.float32),
        "words": ((1, spec.num_frames), jnp.int32),
        "plain_words": ((1, MAX_PLAIN_WORDS), jnp.int32),
    }
    batch = {name: jnp.zeros(*shapes[name]) for name in spec.training_inputs}
    batch |= {
        "directions": jnp.zeros((1, spec.num_frames, spec.skeleton.num_bones, 3), jnp.float32),
        "speaker": jnp.zeros((1,), jnp.int32),
    }
    if spec.identity == "images":
        shape = (1, spec.num_reference_images, spec.image_size, spec.image_size, 3)
        batch["images"] = jnp.zeros(shape, jnp.uint8)
    return batch
