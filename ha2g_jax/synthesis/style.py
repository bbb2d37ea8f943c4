"""Styles for generation: that of a speaker, of a mixture of speakers, of images, or a random one."""

import math
import operator
import pathlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.checkpoint.onnx.reading import Description
from ha2g_jax.errors import UserError, check_number
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_SEED

if TYPE_CHECKING:
    from ha2g_jax.methods.method import Spec, Variables


VARIATION = 0.3  # standard deviation of the difference between a take and the style of its speaker

ImagePaths = str | pathlib.Path | Sequence[str | pathlib.Path]

_NAMES_SHOWN, _LETTERS_SHOWN = 40, 500
_MOST_VARIATION = 2.0


class Style(NamedTuple):
    """A requested style, by at most one of the first five fields; without any, it is random, see `choose_style`.

    People do not speak in the same manner twice: the style of a speaker, a mixture or images is varied with the seed of
    the motion, so that another seed gives another take.

    Attributes:
        speaker: name of a speaker of the training data.
        mixture: name of a speaker -> weight; the weights are divided by their sum.
        images: path of one or more images of a person, of the kind that the model was trained with.
        seed: seed of a random style; by default the seed of the motion.
        values: (style_dim,) the values f_id themselves.
        variation: standard deviation, from 0 to 2, of the noise added to each value of the style of a speaker, a
            mixture or images; 0 for their exact style.
    """

    speaker: str | None = None
    mixture: Mapping[str, float] | None = None
    images: ImagePaths | None = None
    seed: int | None = None
    values: np.ndarray | None = None
    variation: float = VARIATION

    @property
    def has_source(self) -> bool:
        """Whether anything but the seed of the motion determines the style."""
        return any(part is not None for part in self[:5])


RANDOM = Style()


def check_seed(seed: int) -> int:
    """Return a seed as a plain number; raise a `UserError` unless it is a whole number from 0 to `MAX_SEED`."""
    try:
        number = None if isinstance(seed, bool) else operator.index(seed)
    except TypeError:
        number = None
    if number is None:
        raise UserError(f"the seed is {seed!r}; give a whole number")
    if number < 0:
        raise UserError(f"seed {seed} is negative; give 0 or more")
    if number > MAX_SEED:
        raise UserError(f"a seed is above {MAX_SEED}; give a smaller one")
    return number


def later_seed(seed: int, count: int) -> int:
    """Return the seed that comes `count` after another; after `MAX_SEED` comes 0.

    Raises:
        UserError: as `check_seed`.
    """
    return (check_seed(seed) + count) % (MAX_SEED + 1)


def choose_style(
    spec: "Spec | Description", variables: "Variables", assets: Assets, style: Style = RANDOM, seed: int = 0
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the values f_id of a requested style, and a description for the metadata of the motion.

    A random style is drawn from a normal distribution that is fitted after training to the styles of the model's
    speakers (Ghosh et al. 2020). The prior N(0, I) of the paper is much wider than these styles, and motion in a style
    far from all of them trembles. If the model has a single speaker, the style of that one is varied instead; without
    speakers the prior is used.

    Args:
        spec, variables: generator; that of an ONNX file has no variables here, and reads no images.
        assets: assets of the model, with the styles of the speakers.
        style: requested style.
        seed: seed of the variation, and of a random style if `style` has none.

    Returns:
        (style_dim,) float32 values f_id, and plain values that describe the style.

    Raises:
        UserError: more than one style is requested, a speaker is unknown, a weight is impossible, an image cannot be
            read, a seed is negative or above `MAX_SEED`, values are of another number or not finite, the variation is
            not within 0 and 2, or the model has no styles.
    """
    if not isinstance(style, Style):
        raise UserError(f"the style is {style!r}; give a Style, such as Style(speaker='ada')")
    if sum(part is not None for part in style[:5]) > 1:
        raise UserError(
            "the style has more than one source; give only a speaker, a mixture, reference images, values or a style "
            "seed"
        )
    seed = check_seed(seed)
    style_seed = seed if style.seed is None else check_seed(style.seed)
    message = f"the variation of the style is {style.variation}; expected 0 to {_MOST_VARIATION:g}"
    variation = check_number(style.variation, 0, _MOST_VARIATION, message)
    if style.speaker is not None:
        exact, described = _speaker(assets, style.speaker), {"kind": "speaker", "speaker": style.speaker}
        return _varied(exact, variation, seed), described | {"variation": variation}
    if style.mixture is not None:
        weights = _normalized(style.mixture)
        exact = sum(weight * _speaker(assets, name).astype(np.float64) for name, weight in weights.items())
        described = {"kind": "mixture", "speakers": weights, "variation": variation}
        return _varied(np.asarray(exact, np.float32), variation, seed), described
    if style.images is not None:
        images = [style.images] if isinstance(style.images, str | pathlib.Path) else style.images
        exact = _encode_images(spec, variables, assets, images)
        names = [shown(pathlib.Path(path).name) for path in images]
        described = {"kind": "images", "images": names, "variation": variation}
        return _varied(exact, variation, seed), described
    if style.values is not None:
        return _checked(style.values, spec.style_dim), {"kind": "values"}
    if not spec.style_dim:
        if style.seed is not None:
            raise UserError(f"this model, {spec.method}, has no styles; leave out the style seed")
        return np.zeros(0, np.float32), {"kind": "none"}
    return _random(assets, spec.style_dim, style_seed), {"kind": "random", "seed": style_seed}


def _random(assets: Assets, style_dim: int, seed: int) -> np.ndarray:
    """Draw a style (style_dim,) with the mean and the covariance of the speakers' styles."""
    styles = np.array(list(assets.speakers.values()), np.float64)
    if len(styles) == 1:
        return _varied(styles[0].astype(np.float32), VARIATION, seed)
    rng = np.random.default_rng(seed)
    if not len(styles):
        return rng.standard_normal(style_dim, np.float32)
    mean = styles.mean(axis=0)
    weights = rng.standard_normal(len(styles)) / math.sqrt(len(styles) - 1)
    return (mean + weights @ (styles - mean)).astype(np.float32)


def read_mixture(text: str) -> dict[str, float]:
    """Parse the weights of speakers from a text such as A:0.3,B:0.7; a name without a weight has weight 1.

    Raises:
        UserError: the text has another form, or names a speaker twice.
    """
    weights: dict[str, float] = {}
    for part in text.split(","):
        name, _, weight = part.rpartition(":") if ":" in part else (part, "", "1")
        try:
            value = float(weight)
        except ValueError:
            name, value = part, 1.0  # a name with a colon in it
        if not name.strip() or name.strip() in weights:
            raise UserError(
                f"the style '{shown(text)}' names a speaker twice, or none; expected a text such as A:0.3,B:0.7"
            )
        weights[name.strip()] = value
    return weights


def _normalized(weights: Mapping[str, float]) -> dict[str, float]:
    if not isinstance(weights, Mapping):
        raise UserError(f"the mixture is {weights!r}; give the weights of speakers, such as {{'ada': 0.3, 'ben': 0.7}}")
    found = ", ".join(f"{name} {weight}" for name, weight in weights.items()) or "none"
    message = f"the weights of the style are {found}; expected numbers of at least 0, not all of them 0"
    checked = {name: check_number(weight, 0, math.inf, message) for name, weight in weights.items()}
    total = sum(checked.values())
    if not 0 < total < math.inf:
        raise UserError(message)
    return {name: weight / total for name, weight in checked.items()}


def _varied(f_id: np.ndarray, variation: float, seed: int) -> np.ndarray:
    """Add normal noise, whose seed is not that of a random style, to the values of a style."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    return f_id + np.float32(variation) * rng.standard_normal(f_id.shape, np.float32)


def _checked(values: np.ndarray, style_dim: int) -> np.ndarray:
    try:
        f_id = np.asarray(values, np.float32)
    except (TypeError, ValueError) as error:
        raise UserError(f"the values of the style are no numbers; expected {style_dim} finite numbers") from error
    if f_id.shape != (style_dim,) or not np.isfinite(f_id).all():
        raise UserError(f"the style has values of shape {f_id.shape}; expected {style_dim} finite numbers")
    return f_id


def _speaker(assets: Assets, name: str) -> np.ndarray:
    if not isinstance(name, str) or name not in assets.speakers:
        known = _names(assets)
        expected = f"expected one of: {known}" if known else "the model has no speakers"
        raise UserError(f"no speaker '{shown(str(name))}' in the model; {expected}")
    return np.asarray(assets.speakers[name], np.float32)


def _names(assets: Assets) -> str:
    """Return the names of the speakers, shortened and escaped for a message of one line."""
    names = list(assets.speakers)
    listed = ", ".join(names[:_NAMES_SHOWN]) + (
        f" and {len(names) - _NAMES_SHOWN} more" if names[_NAMES_SHOWN:] else ""
    )
    listed = "".join(letter if letter.isprintable() else "?" for letter in listed)
    return listed if len(listed) <= _LETTERS_SHOWN else f"{listed[:_LETTERS_SHOWN]}..."


def _encode_images(
    spec: "Spec | Description", variables: "Variables", assets: Assets, paths: Sequence[str | pathlib.Path]
) -> np.ndarray:
    """Return the style (style_dim,) of images of any size, each cropped to a square around its centre."""
    if isinstance(spec, Description) or spec.identity != "images":
        names = _names(assets)
        known = f"knows speakers by name, not by images; expected one of: {names}" if names else "has no speakers"
        raise UserError(f"this model {known}")
    if not paths:
        raise UserError("an empty list of reference images; give one or more images")
    # JAX and the readers of pictures and of corpora take long to import, and few motions need them.
    from PIL import ImageOps

    from ha2g_jax.data.windows import resize_images
    from ha2g_jax.features.pictures import read_picture
    from ha2g_jax.methods import encode_identity

    images = []
    for path in paths:
        upright = read_picture(path)
        side = min(upright.size)
        square = np.asarray(ImageOps.fit(upright, (side, side)))
        images.append(resize_images(square[None], spec.image_size))
    return np.asarray(encode_identity(spec, variables, np.concatenate(images)))
