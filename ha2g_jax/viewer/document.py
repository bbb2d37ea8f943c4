"""HTML documents that hold all they need: style, scripts, three.js and content."""

import base64
import functools
import hashlib
import html
import importlib.resources
import json
import string
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ha2g_jax.viewer.packing import deflated


class Document(NamedTuple):
    """An HTML document.

    Attributes:
        text: the document.
        style: its style, as text.
        scripts: its scripts, as text.
    """

    text: str
    style: str
    scripts: tuple[str, ...]


def build_document(
    template: str, title: str, content: Mapping[str, Any], styles: Sequence[str], scripts: Sequence[str]
) -> Document:
    """Build a document from files of `assets/viewer`.

    Args:
        template: name of the HTML file, which has places for what follows.
        title: title of the document.
        content: JSON values that the scripts read.
        styles: names of the CSS files.
        scripts: names of the JavaScript files, in the order in which they run.
    """
    style = "".join(read_asset(name) for name in styles)
    code = tuple(f"\n{read_asset(name)}" for name in scripts)
    text = string.Template(read_asset(template)).substitute(
        title=html.escape(title),
        style=style,
        three=_three(),
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
    return (importlib.resources.files("jupyter_threejs_sage") / "static" / "r130" / "three.min.js").read_bytes()


@functools.cache
def _three() -> str:
    return deflated(three_library())
