"""The methods of the paper and one of our own, each a module with the functions of `method.Method`; building specs."""

import functools
from typing import Any

import jax
import jax.numpy as jnp

from ha2g_jax.config import settings
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.limits import MAX_SPEAKERS, MAX_VOCABULARY
from ha2g_jax.methods import autoencoder, energy_ha2g, joint_embedding, seq2seq, speech2gesture, trimodal
from ha2g_jax.methods.ha2g import method as ha2g
from ha2g_jax.methods.ha2g import release
from ha2g_jax.methods.method import GeneratingMethod, Method, Spec, Variables, example_batch
from ha2g_jax.skeleton import Skeleton

METHODS: dict[str, GeneratingMethod] = {
    "ha2g": ha2g,
    "energy_ha2g": energy_ha2g,
    "seq2seq": seq2seq,
    "speech2gesture": speech2gesture,
    "joint_embedding": joint_embedding,
    "trimodal": trimodal,
}
# The auto-encoder generates no motion from speech: it measures motion, see `ha2g_jax.evaluation`.
TRAINABLE: dict[str, Method] = {**METHODS, "autoencoder": autoencoder}


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Spec:
    """Build the networks that a config describes; `config.loss` and `config.train` are not read.

    Skeleton, vocabulary and speakers are those of the training split. If windows are mirrored, the table of speakers
    has twice as many rows: the second half is for the mirror images, in the same order.

    Raises:
        UserError: a setting that is not possible, or that the method cannot use.
    """
    settings.check(config, is_trained=False)
    for kind, count, most in (("words", vocabulary_size, MAX_VOCABULARY), ("speakers", num_speakers, MAX_SPEAKERS)):
        if count > most:
            raise UserError(f"a model of {count} {kind}, expected at most {most}: choose a smaller corpus")
    is_release = config.method == "ha2g" and config.model.architecture == "release"
    method = release if is_release else TRAINABLE[config.method]
    return method.build(config, skeleton, vocabulary_size, num_speakers)


def method_of(spec: Spec) -> Method:
    """Return the functions with which a spec is trained."""
    return release if isinstance(spec.generator, release.ReleaseHA2G) else TRAINABLE[spec.method]


def generating_method_of(spec: Spec) -> GeneratingMethod:
    """Return the functions with which a spec generates motion.

    Raises:
        KeyError: the method generates no motion, such as the pose auto-encoder.
    """
    return release if isinstance(spec.generator, release.ReleaseHA2G) else METHODS[spec.method]


@functools.partial(jax.jit, static_argnums=0)
def encode_identity(spec: Spec, variables: Variables, identity: jax.Array) -> jax.Array:
    """Return the style (style_dim,) of one person, the mean of f_id.

    The identity is images (num_images, S, S, 3) or the index () of a speaker, see `Spec.identity`.
    """
    return generating_method_of(spec).encode_identity(spec, variables, identity[None])[0]


def variable_shapes(spec: Spec) -> Any:
    """Return {"params", "batch_stats"} of the generator as a tree of `jax.ShapeDtypeStruct`."""

    def init() -> Any:  # creates all arrays, so that `eval_shape` neither computes nor compiles anything
        arguments = method_of(spec).init_arguments(spec, example_batch(spec))
        return spec.generator.init(jax.random.key(0), *arguments, train=False)

    shapes = jax.eval_shape(init)
    return {"params": shapes["params"], "batch_stats": shapes.get("batch_stats", {})}


def discriminator_shapes(spec: Spec) -> Any:
    """Return {"params", "batch_stats"} of the discriminator as `variable_shapes` does; the method must have one."""
    poses = jax.ShapeDtypeStruct((1, spec.num_frames, spec.skeleton.pose_dim), jnp.float32)
    return jax.eval_shape(functools.partial(spec.discriminator.init, train=False), jax.random.key(0), poses)
