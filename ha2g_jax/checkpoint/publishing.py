"""Make models to share: a run as a model folder, the average of several models, or a model on the Hub with a card.

Averages of models that were trained from the same weights: Wortsman et al., Model soups, 2022.
"""

import dataclasses
import pathlib
import re
import tempfile
from collections.abc import Sequence

import numpy as np
from flax import traverse_util

from ha2g_jax.checkpoint import hub, model_folder, weights
from ha2g_jax.checkpoint.model_folder import LoadedModel
from ha2g_jax.checkpoint.weights import in_vocabulary, is_word_table
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import file_sha256, read_bytes, shown
from ha2g_jax.limits import MAX_CARD_BYTES

_MAX_DIFFERENCE = 0.1  # between mean directions of a bone, to which the poses of averaged models are relative
_LICENCE = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]{0,63}")


def export(workdir: str | pathlib.Path, out: str | pathlib.Path) -> pathlib.Path:
    """Write the model of a workdir, see `model_folder.load`, as a model folder, and return the folder.

    Raises:
        UserError: as `model_folder.load` and `model_folder.save`.
    """
    model = model_folder.load(workdir)
    return model_folder.save(out, model.config, model.assets, model.variables)


def publish(
    source: str | pathlib.Path,
    name: str,
    licence: str,
    scores: pathlib.Path | None = None,
    *,
    is_private: bool = False,
) -> str:
    """Publish a model as one commit on the Hub, and return the name to load it by, hf://OWNER/NAME@COMMIT.

    The weights are stored as by `model_folder.save`; card and commit name the hash of what is published.

    Args:
        name: OWNER/NAME, or OWNER/NAME@BRANCH for an existing branch other than main.
        licence: licence of the model, as the Hub names it, such as apache-2.0.
        scores: Markdown file of `ha2g evaluate --markdown` to include in the card.

    Raises:
        UserError: there is no model, the scores cannot be read, the licence has another form, or see `hub.publish`.
    """
    hub.parse_name(name)
    if not _LICENCE.fullmatch(licence):
        raise UserError(
            f"'{shown(licence)}' is not the name of a licence; expected one such as apache-2.0 or cc-by-4.0"
        )
    table = "" if scores is None else _text(scores)
    model = model_folder.load(source)
    with tempfile.TemporaryDirectory() as temporary:
        folder = model_folder.save(pathlib.Path(temporary) / "model", model.config, model.assets, model.variables)
        hashes = {file: file_sha256(folder / file) for file in hub.FILES}
        model = model._replace(assets=model_folder.read_description(folder)[1])
        card = write_card(model, name.removeprefix(hub.PREFIX), licence, hashes, table)
        return hub.publish(folder, card, name, is_private=is_private, message=f"Model {model.assets.hash}")


def write_card(model: LoadedModel, name: str, licence: str, hashes: dict[str, str], scores: str = "") -> str:
    """Return the text of a model card: what the Hub reads, how to use the model, what it is, its scores and hashes.

    The name is OWNER/NAME or OWNER/NAME@BRANCH. The hashes are the SHA-256 of each file; the scores are Markdown, ""
    for none.
    """
    spec, flat = model.spec, weights.flatten(model.variables)
    parameters = sum(leaf.size for path, leaf in flat.items() if path.startswith("params"))
    facts = {
        "method": spec.method,
        "config": shown(model.config.name),
        "skeleton": f"{spec.skeleton.name}, {len(spec.skeleton.joints)} joints",
        "frames per second": spec.fps,
        "window": f"{spec.num_frames} frames, the first {spec.num_seed_frames} of them given",
        "parameters": f"{parameters:,}",
        "speakers": len(model.assets.speakers),
        "hash of the weights": model.assets.hash,
    }
    rows = "\n".join(f"| {name} | {value} |" for name, value in facts.items())
    files = "\n".join(f"| `{file}` | `{digest}` |" for file, digest in hashes.items())
    parts = [
        f"---\nlicense: {licence.lower()}\nlibrary_name: ha2g-jax\n"
        "tags:\n- gesture-generation\n- speech\n- motion\n- jax\n---",
        f"# {hub.parse_name(name)[0].partition('/')[2]}",
        "Speech in, gestures out: a model for ha2g-jax.",
        "```python\nimport ha2g_jax\n\n"
        f'model = ha2g_jax.load("{hub.PREFIX}{name}")  # @COMMIT pins these weights\n'
        'model.generate("speech.wav").save("speech.npz")\n```',
        f"| | |\n|---|---|\n{rows}",
        f"## Scores\n\n{scores.strip()}" if scores else "## Scores\n\nNone were published with the model.",
        f"## Files\n\n| file | SHA-256 |\n|---|---|\n{files}",
    ]
    return "\n\n".join(filter(None, parts)) + "\n"


def _text(path: pathlib.Path) -> str:
    expected = "the output of ha2g evaluate --markdown"
    try:
        return read_bytes(path, expected, MAX_CARD_BYTES).decode()
    except UnicodeDecodeError as error:
        raise UserError(f"{shown(path)} is not text in UTF-8; expected {expected}") from error


def average_models(models: Sequence[str | pathlib.Path], out: str | pathlib.Path) -> pathlib.Path:
    """Write the average of two or more models, see `model_folder.load`, as a model folder atomically.

    The weights, the statistics of the normalisation layers and the styles of the speakers are averaged in float32. The
    vector of a word is the mean over the models, where a model that lacks the word counts with its vector of unknown
    words. A model that is given twice counts twice.

    Raises:
        UserError: a model cannot be loaded, the models do not fit together, or the folder cannot be written.
    """
    if len(models) < 2:
        raise UserError(f"{len(models)} model to average; give two or more")
    loaded = [model_folder.load(name) for name in models]
    for name, model in zip(models[1:], loaded[1:], strict=True):
        if difference := _difference(loaded[0], model):
            raise UserError(
                f"{shown(models[0])} and {shown(name)} differ in {difference}; average models that were trained from "
                "the same weights, for the same speakers"
            )
    first = loaded[0]
    flat = [_with_words_of(first, model) for model in loaded]
    variables = traverse_util.unflatten_dict({name: _mean([it[name] for it in flat]) for name in flat[0]}, sep="/")
    speakers = {name: _mean([model.assets.speakers[name] for model in loaded]) for name in first.assets.speakers}
    return model_folder.save(out, first.config, dataclasses.replace(first.assets, speakers=speakers), variables)


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
    for name in settings[0] | settings[1]:
        if settings[0].get(name) != settings[1].get(name):
            return f"model.{name}, {settings[0].get(name)} and {settings[1].get(name)}"
    shapes = [{name: it.shape for name, it in _with_words_of(first, model).items()} for model in (second, first)]
    if sizes := weights.compare(*shapes):
        return f"their weights ({sizes})"
    if sorted(first.assets.speakers) != sorted(second.assets.speakers):
        return "their speakers"
    if first.spec.identity == "speaker" and list(first.assets.speakers) != list(second.assets.speakers):
        return "the order of their speakers"
    means = first.spec.skeleton.mean_directions, second.spec.skeleton.mean_directions
    if np.abs(means[0] - means[1]).max() > _MAX_DIFFERENCE:
        return "the mean pose of their data"
    return ""


def _settings(model: LoadedModel) -> dict[str, object]:
    """Return the settings of the networks by dotted name, without those of initialisation and computation."""
    settings = traverse_util.flatten_dict(model.config.model.to_dict(), sep=".")
    return {name: value for name, value in settings.items() if name not in ("recompute", "text.vectors")}
