"""Start a training run from the weights of a model, to adapt it to other data or to train it longer."""

from typing import Any

from flax import traverse_util

from ha2g_jax.checkpoint import loading, weights
from ha2g_jax.checkpoint.word_tables import TABLE, in_vocabulary, is_word_table
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods.build import variable_shapes
from ha2g_jax.methods.method import Spec

_IDENTITY = "identity"  # name of the network E_ID


def initial_variables(source: str, spec: Spec, vocabulary: Vocabulary) -> dict[str, Any]:
    """Read the weights of a model as the initial ones of a generator for other words and speakers.

    A word that the model knows keeps its vector; every other word starts with that of unknown words. A table of
    speakers is left out, and starts anew. So does all of E_ID where the model has styles from images and the generator
    from a table, or the other way round.

    Args:
        source: the model, see `ha2g_jax.checkpoint.loading.load`.
        spec: networks and sizes of the generator.
        vocabulary: words of the generator.

    Returns:
        A part of the tree {"params", "batch_stats"} of the generator.

    Raises:
        UserError: there is no such model, or it has another method, skeleton or size than the generator.
    """
    model = loading.load(source)
    if model.spec.method != spec.method:
        raise UserError(f"{source} is a model of {model.spec.method}, but the config of {spec.method}")
    if model.spec.skeleton.bones != spec.skeleton.bones:
        raise UserError(f"{source} has skeleton {model.spec.skeleton.name}, but the config has {spec.skeleton.name}")
    found = weights.flatten(model.variables)
    for name in filter(is_word_table, found):
        found[name] = in_vocabulary(found[name], model.assets.vocabulary, vocabulary)
    has_same_kind = model.spec.identity == spec.identity
    expected = {name: leaf.shape for name, leaf in weights.flatten(variable_shapes(spec)).items()}
    found, expected = (
        {name: value for name, value in tree.items() if not _is_new(name, has_same_kind)} for tree in (found, expected)
    )
    if difference := weights.compare({name: array.shape for name, array in found.items()}, expected):
        raise UserError(
            f"{source} has other networks than the config ({difference}): give the preset or the settings "
            "config.model that it was trained with"
        )
    return traverse_util.unflatten_dict(found, sep="/")


def _is_new(name: str, has_same_kind: bool) -> bool:
    """Return whether a variable belongs to the speakers of one corpus, and so starts anew on another."""
    is_identity = name.split("/")[1] == _IDENTITY
    return (name.endswith(TABLE) and not is_word_table(name)) or (is_identity and not has_same_kind)
