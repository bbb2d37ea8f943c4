"""Style of a clip's speaker, as the model takes it."""

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
    """Return f_id (style_dim,) of a clip's speaker: the mean of E_ID, zeros for a model without an identity.

    A model that reads images gets the reference frames of the clip. A model with a table of speakers gets the style of
    the speaker's name; for a name that is not in the table it gets the mean of all styles.

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
