"""Publishing of a model on the Hugging Face Hub: a model folder, and a card that says what it is."""

import hashlib
import pathlib
import re
import tempfile

from ha2g_jax.checkpoint import hub, loading, model_folder, weights
from ha2g_jax.checkpoint.model_folder import LoadedModel
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import read_bytes, shown
from ha2g_jax.limits import MAX_CARD_BYTES

_LICENCE = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]{0,63}")


def publish(
    source: str | pathlib.Path,
    name: str,
    licence: str,
    scores: pathlib.Path | None = None,
    *,
    is_private: bool = False,
) -> str:
    """Publish a model as one commit on the Hub.

    Args:
        source: model, see `loading.load`.
        name: OWNER/NAME.
        licence: licence of the model, as the Hub names it, such as apache-2.0.
        scores: Markdown file of `ha2g evaluate --markdown`, which the card has; None for a card without scores.
        is_private: whether a new repository is private.

    Returns:
        The name to load it by, hf://OWNER/NAME@COMMIT.

    Raises:
        UserError: there is no model, the scores cannot be read, the licence has another form, or see `hub.publish`.
    """
    repository = hub.parse_name(name).repository
    if not _LICENCE.fullmatch(licence):
        raise UserError(f"{shown(licence)} is not the name of a licence; expected one such as apache-2.0 or cc-by-4.0")
    table = "" if scores is None else _text(scores)
    model = loading.load(source)
    with tempfile.TemporaryDirectory() as temporary:
        folder = model_folder.save(pathlib.Path(temporary) / "model", model.config, model.assets, model.variables)
        hashes = {file: hashlib.sha256((folder / file).read_bytes()).hexdigest() for file in hub.FILES}
        card = write_card(model, repository, licence, hashes, table)
        return hub.publish(folder, card, name, is_private=is_private, message=f"Model {model.assets.hash}")


def write_card(model: LoadedModel, repository: str, licence: str, hashes: dict[str, str], scores: str = "") -> str:
    """Return the text of a model card: what the Hub reads, how to use the model, what it is, its scores and hashes.

    Args:
        model: model.
        repository: OWNER/NAME.
        licence: licence of the model.
        hashes: name of each file -> SHA-256 in hexadecimal digits.
        scores: Markdown with scores, "" for none.
    """
    spec, flat = model.spec, weights.flatten(model.variables)
    parameters = sum(leaf.size for path, leaf in flat.items() if path.startswith("params"))
    facts = {
        "method": spec.method,
        "config": model.config.name,
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
        f"# {repository.partition('/')[2]}",
        "Speech in, gestures out: a model for ha2g-jax.",
        "```python\nimport ha2g_jax\n\n"
        f'model = ha2g_jax.load("{hub.PREFIX}{repository}")  # add @COMMIT to pin these weights\n'
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
