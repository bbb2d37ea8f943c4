"""Averages of the weights of models that were trained from the same weights (Wortsman et al., Model soups, 2022)."""

import dataclasses
import pathlib
from collections.abc import Sequence

import numpy as np
from flax import traverse_util

from ha2g_jax.checkpoint import model_folder, weights
from ha2g_jax.checkpoint.loading import load
from ha2g_jax.checkpoint.model_folder import LoadedModel
from ha2g_jax.checkpoint.word_tables import in_vocabulary, is_word_table
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown

_MAX_DIFFERENCE = 0.1  # of the mean direction of a bone, which the poses of a model are relative to


def average_models(models: Sequence[str | pathlib.Path], out: str | pathlib.Path) -> pathlib.Path:
    """Write the average of models as a model folder, completely or not at all.

    Args:
        models: two or more models: workdirs, checkpoints in them, or model folders, see `load`. A model that is given
            twice counts twice.
        out: folder to write, which does not exist or is empty.

    Returns:
        The model folder.

    Raises:
        UserError: a model cannot be loaded, the models do not fit together, or the folder cannot be written.
    """
    if len(models) < 2:
        raise UserError(f"{len(models)} model to average; give two or more")
    loaded = [load(name) for name in models]
    for name, model in zip(models[1:], loaded[1:], strict=True):
        if difference := _difference(loaded[0], model):
            raise UserError(
                f"{shown(models[0])} and {shown(name)} differ in {difference}; average models that were trained from "
                "the same weights, for the same speakers"
            )
    mean = average(loaded)
    return model_folder.save(out, mean.config, mean.assets, mean.variables)


def average(models: Sequence[LoadedModel]) -> LoadedModel:
    """Average the weights, the statistics of the normalisation layers, and the styles of the speakers.

    Args:
        models: models of the same networks and speakers.

    Returns:
        The first model with these values, float32. The vector of a word is the mean of those that the models have for
        it, where a model that lacks it counts with its vector of unknown words. The hash is set when it is saved.
    """
    first = models[0]
    flat = [_with_words_of(first, model) for model in models]
    variables = traverse_util.unflatten_dict({name: _mean([it[name] for it in flat]) for name in flat[0]}, sep="/")
    speakers = {name: _mean([model.assets.speakers[name] for model in models]) for name in first.assets.speakers}
    return first._replace(variables=variables, assets=dataclasses.replace(first.assets, speakers=speakers, hash=""))


def _mean(arrays: Sequence[np.ndarray]) -> np.ndarray:
    return np.asarray(np.mean(arrays, axis=0, dtype=np.float64), np.float32)


def _with_words_of(first: LoadedModel, model: LoadedModel) -> dict[str, np.ndarray]:
    """Return the variables of a model by name, with tables of words in the order of the first one's."""
    before, after = model.assets.vocabulary, first.assets.vocabulary
    flat = weights.flatten(model.variables)
    return {name: in_vocabulary(it, before, after) if is_word_table(name) else it for name, it in flat.items()}


def _difference(first: LoadedModel, second: LoadedModel) -> str:
    """Describe how two models differ that cannot be averaged; return "" if they can."""
    for name in ("method", "identity", "num_frames", "num_seed_frames", "fps"):
        if getattr(first.spec, name) != getattr(second.spec, name):
            return f"{name}, {getattr(first.spec, name)} and {getattr(second.spec, name)}"
    if first.spec.skeleton.bones != second.spec.skeleton.bones:
        return f"the skeleton, {first.spec.skeleton.name} and {second.spec.skeleton.name}"
    settings = [_settings(model) for model in (first, second)]
    for name in settings[0].keys() | settings[1].keys():
        if settings[0].get(name) != settings[1].get(name):
            return f"model.{name}, {settings[0].get(name)} and {settings[1].get(name)}"
    shapes = [{name: it.shape for name, it in _with_words_of(first, model).items()} for model in (second, first)]
    if sizes := weights.compare(*shapes):
        return f"their weights ({sizes})"
    if sorted(first.assets.speakers) != sorted(second.assets.speakers):
        return "their speakers"
    means = first.spec.skeleton.mean_directions, second.spec.skeleton.mean_directions
    if np.abs(means[0] - means[1]).max() > _MAX_DIFFERENCE:
        return "the mean pose of their data"
    return ""


def _settings(model: LoadedModel) -> dict[str, object]:
    """Return the settings of the networks by dotted name, without those of how they begin and are computed."""
    settings = traverse_util.flatten_dict(model.config.model.to_dict(), sep=".")
    return {name: value for name, value in settings.items() if name not in ("recompute", "text.vectors")}
