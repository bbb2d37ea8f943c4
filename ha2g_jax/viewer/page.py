"""The page of the viewer: motions, sound, words, its JavaScript and three.js in one HTML document."""

import base64
import dataclasses
import functools
import hashlib
import html
import importlib.resources
import json
import pathlib
import string
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.files.writing import whole_file
from ha2g_jax.limits import MAX_MOTION_FRAMES
from ha2g_jax.motion.motion import Motion
from ha2g_jax.viewer import packing
from ha2g_jax.viewer.packing import LEVELS, PEAK_RATE, deflated, pack_motion, peaks

MAX_MOTIONS = 12
_SCRIPTS = ("motion.js", "loft.js", "head.js", "arm.js", "body.js", "stage.js", "timeline.js", "player.js")


@dataclasses.dataclass(frozen=True)
class Page:
    """An HTML document, which a notebook shows as the result of a cell, in a frame of `height` pixels."""

    text: str = dataclasses.field(repr=False)
    height: int = 620

    def _repr_html_(self) -> str:
        style = f"width: 100%; height: {self.height}px; border: 0; border-radius: 10px"
        return f'<iframe style="{style}" allow="autoplay; fullscreen" srcdoc="{html.escape(self.text)}"></iframe>'

    def save(self, path: str | pathlib.Path) -> pathlib.Path:
        """Write the page to an `.html` file, completely or not at all, and return its path.

        Raises:
            UserError: the path does not end in `.html`, or the file cannot be written.
        """
        path = pathlib.Path(path)
        if path.suffix.lower() not in (".html", ".htm"):
            raise UserError(f"the viewer is an HTML page, not {path.name!r}; give a name that ends in .html")
        with whole_file(path) as temporary:
            temporary.write_text(self.text, encoding="utf-8")
        return path


def view(
    motions: Motion | Mapping[str, Motion],
    audio: np.ndarray | None = None,
    sample_rate: int = SAMPLE_RATE,
    words: Sequence[Word] = (),
    *,
    title: str = "",
    height: int = 620,
) -> Page:
    """Build a page that plays motions side by side with their sound and loads nothing from the network.

    `Page.save` writes it. The same input gives the same bytes.

    Args:
        motions: one motion, or several by name, in order from left to right.
        audio: (samples,) float32 mono sound; None for silence.
        title: title of the page; by default the names of the motions.

    Raises:
        UserError: there is no motion, there are too many, or one is too long or not valid (see `Motion.check`), or the
            sound is not mono or not finite.
    """
    motions = {"": motions} if isinstance(motions, Motion) else dict(motions)
    _check(motions)
    if audio is not None and np.ndim(audio) != 1:
        raise UserError(f"the sound has shape {np.shape(audio)}; mix it to mono, (samples,)")
    if audio is not None and not np.isfinite(audio).all():
        raise UserError("the sound has samples that are not finite; read or compute it again")
    duration = max(motion.num_frames / motion.fps for motion in motions.values())
    content = {
        "motions": [{"name": name, **pack_motion(motion)} for name, motion in motions.items()],
        "levels": LEVELS,
        "words": [[word.text, round(word.start, 3), round(word.end, 3)] for word in words],
        "sound": None,
    }
    if audio is not None and len(audio):
        # The player takes its time from the sound, so the sound lasts at least as long as the longest motion.
        padded = np.pad(audio, (0, max(0, round(duration * sample_rate) - len(audio))))
        duration = len(padded) / sample_rate
        content["sound"] = base64.b64encode(packing.encode_sound(padded, sample_rate)).decode()
        content["peaks"], content["peakRate"] = peaks(padded, sample_rate), PEAK_RATE
    content["duration"] = duration
    title = title or ", ".join(filter(None, motions)) or "Motion"
    return Page(build_document("page.html", title, content, ("style.css",), _SCRIPTS).text, height)


def _check(motions: Mapping[str, Motion]) -> None:
    if not 1 <= len(motions) <= MAX_MOTIONS:
        raise UserError(f"{len(motions)} motions for one page; expected 1 to {MAX_MOTIONS}, make several pages")
    for motion in motions.values():
        motion.check()
    frames = sum(motion.num_frames for motion in motions.values())
    if frames > MAX_MOTION_FRAMES:  # a page of so many has about 100 MB
        raise UserError(
            f"{frames} frames for one page; expected at most {MAX_MOTION_FRAMES}, cut the motion into parts"
        )


class Document(NamedTuple):
    """An HTML document with the texts of its style and its scripts."""

    text: str
    style: str
    scripts: tuple[str, ...]


def build_document(
    template: str, title: str, content: Mapping[str, Any], styles: Sequence[str], scripts: Sequence[str]
) -> Document:
    """Build a document from files of `assets/viewer`.

    Args:
        template: name of the HTML file, which has places for what follows.
        content: JSON values that the scripts read.
        scripts: names of the JavaScript files, in the order in which they run.
    """
    style = "".join(read_asset(name) for name in styles)
    code = tuple(f"\n{read_asset(name)}" for name in scripts)
    text = string.Template(read_asset(template)).substitute(
        title=html.escape(title),
        style=style,
        three=_deflated_three(),
        # A "<" could end the script element.
        content=json.dumps(content, sort_keys=True, separators=(",", ":")).replace("<", "\\u003c"),
        scripts="\n".join(f"<script>{script}</script>" for script in code),
    )
    return Document(text, style, code)


def source_hash(text: str) -> str:
    """Return the source of a Content-Security-Policy that allows an element with a text, and no other."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def read_asset(name: str) -> str:
    """Return the text of a file of `assets/viewer`."""
    return (importlib.resources.files("ha2g_jax") / "assets" / "viewer" / name).read_text("utf-8")


def three_library() -> bytes:
    """Return the script three.js, release 130 with OrbitControls, as UTF-8."""
    return (importlib.resources.files("ha2g_jax") / "assets" / "viewer" / "three.min.js").read_bytes()


@functools.cache
def _deflated_three() -> str:
    return deflated(three_library())
