"""The speakers of a model, and how they move, if known."""

import pathlib
from typing import Any

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.data.corpus import TALK
from ha2g_jax.data.talk.speakers import Style, default_styles
from ha2g_jax.files.reading import shown

_NUMBERS = ("handedness", "amplitude", "mixing", "elbow")  # the most visible numbers of the style of Talk
# Words for a number of the style below -`_CLEAR` and above it.
_WORDS = {
    "amplitude": ("small", "large"),
    "mixing": ("mostly gestures of words", "mostly beats"),
    "elbow": ("arms close to the body", "arms wide"),
    "latency": ("early", "late"),
}
_CLEAR = 0.33
_LEGEND = """\
The speakers of Talk are made by a program. These are its numbers of how they move, each from -1 to 1:
  handedness  which hand does more: -1 left, 1 right
  amplitude   size of all movement: -1 small, 1 large
  mixing      -1 mostly gestures of words, 1 mostly beats
  elbow       -1 arms close to the body and low, 1 wide and high
How far a model follows them is measured by ha2g evaluate."""
_NO_LEGEND = "A model stores the name and the style of its speakers, and nothing about how they move."


def describe_speakers(checkpoint: str | pathlib.Path) -> list[dict[str, Any]]:
    """Return the speakers of a model in the order of training.

    Returns:
        For each speaker its "name" and, if the model was trained on the default Talk corpus, the "hand" that does more,
        numbers of the style from -1 to 1, see `data.talk.speakers.Style`, and how it moves "in_words".

    Raises:
        UserError: there is no model, or it is damaged.
    """
    model = model_folder.load(checkpoint)
    known = default_styles() if model.config.data.path == TALK else {}
    rows: list[dict[str, Any]] = []
    for name in model.assets.speakers:
        row: dict[str, Any] = {"name": name}
        if name in known:
            style = known[name]
            row["hand"] = "right" if style.handedness > 0 else "left"
            row |= {number: round(getattr(style, number), 2) for number in _NUMBERS}
            row["in_words"] = in_words(style)
        rows.append(row)
    return rows


def in_words(style: Style) -> str:
    """Return how a speaker of Talk moves, such as "left-handed, large, mostly beats"."""
    words = ["right-handed" if style.handedness > 0 else "left-handed"]
    for name, (low, high) in _WORDS.items():
        if abs(value := getattr(style, name)) > _CLEAR:
            words.append(high if value > 0 else low)
    return ", ".join(words)


def speakers_as_table(rows: list[dict[str, Any]]) -> str:
    """Return the result of `describe_speakers` as text, with an explanation of the numbers."""
    if not rows:
        return "The model has no speakers."
    columns = list(rows[0])
    cells = [
        [name.replace("_", " ") for name in columns],
        *([_text(row.get(name, "")) for name in columns] for row in rows),
    ]
    widths = [max(len(line[index]) for line in cells) for index in range(len(columns))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip() for line in cells]
    return "\n".join([*lines, "", _LEGEND if "hand" in columns else _NO_LEGEND])


def _text(value: str | float) -> str:
    return shown(value) if isinstance(value, str) else f"{value:+.2f}"
