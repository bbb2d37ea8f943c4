"""The style that a motion is generated in: a speaker's, a mixture of speakers', of images, or one drawn."""

import math
import pathlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from PIL import Image, ImageOps

from ha2g_jax.data.windows import resize_frames
from ha2g_jax.errors import UserError

if TYPE_CHECKING:
    from ha2g_jax.synthesis.model import Model


def choose_style(
    model: "Model",
    speaker: str | None = None,
    reference_images: str | pathlib.Path | Sequence[str | pathlib.Path] | None = None,
    style_seed: int | None = None,
    seed: int = 0,
    *,
    style: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """The identity f_id (18,) that `Model.generate` takes for these arguments, and a description of it for the record.

    Raises:
        UserError: more than one source, an unknown speaker, an impossible share, an image that cannot be read, or a
            negative seed.
    """
    if sum(source is not None for source in (speaker, reference_images, style_seed, style)) > 1:
        raise UserError(
            "the style has more than one source; give a speaker, a mixture, reference images or a style seed"
        )
    if min(seed, style_seed or 0) < 0:
        raise UserError(f"seed {min(seed, style_seed or 0)} is negative; give 0 or more")
    if speaker is not None:
        return _speaker(model, speaker), {"kind": "speaker", "speaker": speaker}
    if style is not None:
        shares = _shares(style)
        f_id = np.sum([share * _speaker(model, name).astype(np.float64) for name, share in shares.items()], axis=0)
        return f_id.astype(np.float32), {"kind": "mixture", "speakers": shares}
    if reference_images is not None:
        if isinstance(reference_images, str | pathlib.Path):
            reference_images = [reference_images]
        names = [pathlib.Path(path).name for path in reference_images]
        return _encode_images(model, reference_images), {"kind": "images", "images": names}
    style_seed = seed if style_seed is None else style_seed
    style_dim = model.task.generator.style_dim
    f_id = np.random.default_rng(style_seed).standard_normal(style_dim, np.float32)
    return f_id, {"kind": "prior", "seed": style_seed}


def read_mixture(text: str) -> dict[str, float]:
    """Shares by speaker of A:0.3,B:0.7; a name without a share has 1.

    Raises:
        UserError: it is written in another way, or names a speaker twice.
    """
    shares: dict[str, float] = {}
    for part in text.split(","):
        name, _, share = part.rpartition(":") if ":" in part else (part, "", "1")
        try:
            value = float(share)
        except ValueError:
            name, value = part, 1.0  # a name with a colon in it
        if not name.strip() or name.strip() in shares:
            raise UserError(f"the style {text!r} names a speaker twice, or none; expected one such as A:0.3,B:0.7")
        shares[name.strip()] = value
    return shares


def _shares(style: Mapping[str, float]) -> dict[str, float]:
    """Shares whose sum is 1."""
    total = sum(style.values())
    if not (math.isfinite(total) and total > 0 and min(style.values()) >= 0):
        found = ", ".join(f"{name} {share:g}" for name, share in style.items()) or "none"
        raise UserError(f"the shares of the style are {found}; expected numbers from 0 on, not all of them 0")
    return {name: share / total for name, share in style.items()}


def _speaker(model: "Model", name: str) -> np.ndarray:
    """The mean of f_id (18,) of a speaker of the training data."""
    if name not in model.assets.speakers:
        known = ", ".join(model.assets.speakers)
        expected = f"expected one of: {known}" if known else "it knows none"
        raise UserError(f"no speaker {name!r} in the model; {expected}")
    return np.asarray(model.assets.speakers[name], np.float32)


def _encode_images(model: "Model", paths: Sequence[str | pathlib.Path]) -> np.ndarray:
    """The mean of f_id (18,) for pictures of any size, cut to a square about the middle."""
    if model.task.identity_input != "frames":
        names = ", ".join(model.assets.speakers)
        known = f"knows speakers by name, not by images; expected one of: {names}" if names else "knows no speakers"
        raise UserError(f"this model {known}")
    if not paths:
        raise UserError("an empty list of reference images; give one or more pictures")
    images = []
    for path in paths:
        try:
            with Image.open(path) as image:
                picture = ImageOps.exif_transpose(image).convert("RGB")
        except (OSError, ValueError, Image.DecompressionBombError) as error:
            raise UserError(f"{path} cannot be read as an image; expected a PNG or JPEG of a person") from error
        side = min(picture.size)
        square = np.asarray(ImageOps.fit(picture, (side, side)))
        images.append(resize_frames(square[None], model.task.image_size))
    frames = jnp.asarray(np.concatenate(images))[None]
    outputs: Any = model.task.generator.apply(model.variables, frames, train=False, method="encode_identity")
    mean, _ = outputs
    return np.asarray(mean[0])
