"""A model with random weights at the sizes of a config, for measurements that do not depend on the weights."""

import jax
import numpy as np

from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config.settings import Config
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods import build, variable_shapes
from ha2g_jax.methods.method import Spec, Variables
from ha2g_jax.skeleton import load_skeleton, normalize

_SPEAKERS = 10
_SEED_POSES = 3


def random_model(config: Config) -> tuple[Spec, Variables, Assets]:
    """Return the networks of a config, random variables and assets.

    Args:
        config: settings, see `ha2g_jax.config.settings.paper`.

    Returns:
        The spec; {"params", "batch_stats"}, kernels with a variance of 1 / (3 fan in); and the assets of ten speakers.

    Raises:
        UserError: a setting cannot be used.
    """
    skeleton, vocabulary = load_skeleton(config.skeleton), Vocabulary(("one", "two"))
    spec = build(config, skeleton, len(vocabulary), _SPEAKERS)
    random = np.random.default_rng(0)

    def draw(leaf: jax.ShapeDtypeStruct) -> np.ndarray:
        fan_in = np.prod(leaf.shape[:-1])
        return random.normal(0, (3 * max(fan_in, 1)) ** -0.5, leaf.shape).astype(leaf.dtype)

    shapes = variable_shapes(spec)
    variables = {
        "params": jax.tree.map(draw, shapes["params"]),
        "batch_stats": jax.tree.map(lambda leaf: np.ones(leaf.shape, leaf.dtype), shapes["batch_stats"]),
    }
    directions = random.normal(0, 0.05, (_SEED_POSES, spec.num_seed_frames, skeleton.num_bones, 3))
    assets = Assets(
        skeleton=skeleton,
        vocabulary=vocabulary,
        speakers={str(number): random.normal(size=spec.style_dim).astype(np.float32) for number in range(_SPEAKERS)},
        seed_poses=normalize((skeleton.mean_directions + directions).astype(np.float32)),
        hash="random",
    )
    return spec, variables, assets
