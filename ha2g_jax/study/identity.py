"""The style that a clip asks for, as the model takes it."""

import functools
from typing import Any

import jax
import numpy as np

from ha2g_jax.data.records import Clip
from ha2g_jax.data.windows import resize_frames
from ha2g_jax.errors import UserError
from ha2g_jax.methods.task import Task
from ha2g_jax.synthesis import Model


def clip_identity(model: Model, clip: Clip) -> np.ndarray:
    """f_id (style_dim,) of a clip's speaker: the mean that E_ID gives, zeros for a model that knows no identity.

    A model that reads images sees the reference frames of the clip. One with a table of speakers looks the name up;
    a name that it does not know has no style, so it gets the average of those it knows.

    Raises:
        UserError: the model reads images and the clip has none.
    """
    if not model.task.identity_input:
        return np.zeros(model.task.generator.style_dim, np.float32)
    if model.task.identity_input != "frames":
        known = model.assets.speakers
        return np.asarray(known.get(clip.speaker, np.mean(list(known.values()), axis=0)), np.float32)
    if clip.reference_frames is None:
        raise UserError(f"clip {clip.id} has no reference frames, which this model needs; give a corpus that has them")
    frames = resize_frames(clip.reference_frames[: model.task.num_reference_frames], model.task.image_size)
    return np.asarray(_encode(model.task, model.variables, frames[None])[0])


@functools.partial(jax.jit, static_argnames="task")
def _encode(task: Task, variables: dict[str, Any], frames: jax.Array) -> jax.Array:
    mean, _ = task.generator.apply(variables, frames, train=False, method="encode_identity")
    return mean
