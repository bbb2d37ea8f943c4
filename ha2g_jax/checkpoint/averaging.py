"""Averages of the weights of models that were trained from the same weights (Wortsman et al., Model soups, 2022).

Models that start from the same weights and are trained apart, by other seeds or more steps, mostly lie in one basin of
the loss. Their average then has less of what each has learned by chance, at no cost when it generates.
"""

import dataclasses
import pathlib
from collections.abc import Sequence

import jax
import numpy as np

from ha2g_jax.checkpoint import model_folder, weights
from ha2g_jax.checkpoint.assets import STATISTICS
from ha2g_jax.checkpoint.loading import load
from ha2g_jax.checkpoint.model_folder import LoadedModel
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown


def average_models(models: Sequence[str | pathlib.Path], out: str | pathlib.Path) -> pathlib.Path:
    """Write the average of models as a model folder, completely or not at all.

    Args:
        models: two or more models: workdirs, checkpoints in them, or model folders, see `load`.
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
                f"{shown(models[0])} and {shown(name)} have {difference}; average models of one config and one corpus"
            )
    mean = average(loaded)
    return model_folder.save(out, mean.config, mean.assets, mean.variables)


def average(models: Sequence[LoadedModel]) -> LoadedModel:
    """Average the weights, the statistics of the normalisation layers, and the styles of the speakers.

    Args:
        models: models of the same networks, words, speakers and skeleton.

    Returns:
        The first model with these values; the hash in its assets is set when it is saved.
    """
    first = models[0]
    mean = jax.tree.map(lambda *leaves: np.mean(leaves, axis=0, dtype=np.float64).astype(np.float32), *_values(models))
    variables, speakers = mean
    return first._replace(variables=variables, assets=dataclasses.replace(first.assets, speakers=speakers, hash=""))


def _values(models: Sequence[LoadedModel]) -> list[tuple[dict, dict]]:
    return [(model.variables, model.assets.speakers) for model in models]


def _difference(first: LoadedModel, second: LoadedModel) -> str:
    """Return in what two models differ that are not of one config and one corpus, "" if nothing."""
    shapes = [{name: leaf.shape for name, leaf in weights.flatten(it.variables).items()} for it in (first, second)]
    assets = first.assets, second.assets
    if first.config.method != second.config.method or first.config.model != second.config.model:
        return "different settings of the model"
    if assets[0].skeleton.name != assets[1].skeleton.name:
        return "different skeletons"
    if assets[0].vocabulary.words != assets[1].vocabulary.words:
        return "different words"
    if list(assets[0].speakers) != list(assets[1].speakers):
        return "different speakers"
    if weights.compare(*shapes):
        return "weights of different sizes"
    if not all(np.allclose(*(getattr(it.skeleton, name) for it in assets), atol=1e-5) for name in STATISTICS):
        return "been trained on different motion"
    return ""
