"""The site of a study: a page, its scripts, and what they show, without anything that tells systems apart."""

import html
import importlib.resources
import json
import pathlib
import string
import urllib.parse
from collections.abc import Sequence
from typing import NamedTuple

from ha2g_jax.apps.user_study.design import Key, item_as_json
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import read_bytes, reading, shown

DEFAULT_TITLE = "How people gesture"

SCRIPTS = (
    *("study.css", "study.js", "elements.js", "session.js", "player.js", "questions.js", "pages.js", "sending.js"),
    *("texts.js", "jspsych.min.js", "LICENSES.txt"),
)
"""Files of `assets/study` that a site has besides its page."""

_FORMAT, _VERSION = "ha2g-study-items", 1
_PAGE = "index.html"
_MAX_TEXT_BYTES = 1 << 16
_MAX_TITLE = 200
_LOCAL = ("localhost", "127.0.0.1", "::1")
_CONSENT = """You will watch short clips of an animated figure that moves while a person speaks, and answer questions \
about them. You need sound: headphones or loudspeakers. There are no right or wrong answers; we ask for your impression.

Taking part is voluntary. You may stop at any time by closing the page, without giving a reason, and then no answers \
are passed on. We record your answers, how long they take and how often you play a clip, your comments, and the name \
and language of your browser. We do not ask for your name or your address.

The answers are used for research on animated figures, and may be published without anything that identifies you. If \
you have a question, write to the person who invited you before you begin."""
_CLOSING = "Thank you for taking part."


class Wording(NamedTuple):
    """The texts of a study, in paragraphs, and the address that answers are sent to, if any."""

    title: str
    consent: tuple[str, ...]
    closing: tuple[str, ...]
    post: str | None


def read_wording(
    *,
    title: str = DEFAULT_TITLE,
    consent: pathlib.Path | None = None,
    closing: pathlib.Path | None = None,
    post: str | None = None,
) -> Wording:
    """Read the texts of a study, in paragraphs with blank lines between them, and check its address.

    Args:
        title: title that participants see.
        consent: text file with what participants agree to; by default a short text.
        closing: text file with what participants see at the end, such as a completion code.
        post: address that the answers are sent to; without it participants download them.

    Raises:
        UserError: a text cannot be read or is empty, the title is too long, or the address cannot be used.
    """
    if not title.strip() or len(title) > _MAX_TITLE or not title.isprintable():
        raise UserError(f"the title has {len(title)} characters; expected 1 to {_MAX_TITLE} in one line")
    return Wording(
        title.strip(),
        _paragraphs(consent, _CONSENT),
        _paragraphs(closing, _CLOSING),
        None if post is None else _check_address(post),
    )


def write_site(folder: pathlib.Path, key: Key, lists: Sequence[Sequence[str]], wording: Wording) -> None:
    """Write all of a site but its videos to a folder, which exists; `lists` has the ids of the items of each list.

    Raises:
        OSError: a file cannot be written.
    """
    assets = importlib.resources.files("ha2g_jax") / "assets" / "study"
    for name in SCRIPTS:
        lines = (assets / name).read_bytes().splitlines(keepends=True)
        # A source map is at another host, where developer tools would fetch it.
        (folder / name).write_bytes(b"".join(line for line in lines if not line.startswith(b"//# sourceMappingURL=")))
    page = string.Template((assets / _PAGE).read_text("utf-8"))
    address = urllib.parse.urlsplit(wording.post or "")
    origin = f" {address.scheme}://{address.netloc}" if wording.post else ""
    text = page.substitute(title=html.escape(wording.title), post=html.escape(origin))
    (folder / _PAGE).write_text(text, encoding="utf-8")
    content = {
        "format": _FORMAT,
        "version": _VERSION,
        "study": key.study,
        **wording._asdict(),
        "scales": key.scales,
        "points": key.points,
        "items": [item_as_json(item._replace(expected=None)) for item in key.items],
        "lists": lists,
    }
    (folder / "items.json").write_text(json.dumps(content, separators=(",", ":")) + "\n", encoding="utf-8")


def _paragraphs(path: pathlib.Path | None, default: str) -> tuple[str, ...]:
    if path is None:
        text = default
    else:
        content = read_bytes(path, "a text", _MAX_TEXT_BYTES)
        with reading(path, "a text in UTF-8"):
            text = content.decode("utf-8-sig")
    lines = [line.strip() for line in text.splitlines()]
    paragraphs = tuple(part for part in (" ".join(part.split()) for part in "\n".join(lines).split("\n\n")) if part)
    if not paragraphs:
        raise UserError(f"{shown(path or '')} is empty; expected a text for the participants")
    return paragraphs


def _check_address(post: str) -> str:
    try:
        parts = urllib.parse.urlsplit(post)
        is_right = parts.port is None or parts.port > 0
    except ValueError:
        is_right = False
    else:
        is_secure = parts.scheme == "https" or (parts.scheme == "http" and parts.hostname in _LOCAL)
        is_right &= is_secure and bool(parts.hostname) and not parts.username and not parts.fragment
        is_right &= post.isascii() and post.isprintable() and not set(post) & set(" ;,'\"<>\\")
    if not is_right:
        raise UserError(
            f"answers cannot be sent to {shown(post)}; give an address that starts with https://, or with "
            "http://localhost for a test"
        )
    return post
