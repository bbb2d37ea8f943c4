"""The style of a clip's speaker, as a model takes it."""

import numpy as np

from ha2g_jax.data.records import Clip
from ha2g_jax.data.windows import resize_images
from ha2g_jax.errors import UserError
from ha2g_jax.methods.build import encode_identity
from ha2g_jax.synthesis import Model


def clip_identity(model: Model, clip: Clip) -> np.ndarray:
    """Return the style (style_dim,) of a clip's speaker: the mean of f_id, zeros for a model without identities.

    A model that reads images takes the reference images of the clip. One with a table of speakers looks the name up;
    a name that is not in the table has no style, so it gets the average of those that are.

    Raises:
        UserError: the model reads images and the clip has none.
    """
    spec = model.spec
    if not spec.identity:
        return np.zeros(spec.style_dim, np.float32)
    if spec.identity != "images":
        known = model.assets.speakers
        return np.asarray(known.get(clip.speaker, np.mean(list(known.values()), axis=0)), np.float32)
    if clip.reference_images is None:
        raise UserError(f"clip {clip.id} has no reference images, which this model needs; give a corpus that has them")
    images = resize_images(clip.reference_images[: spec.num_reference_images], spec.image_size)
    return np.asarray(encode_identity(spec, model.variables, images))
