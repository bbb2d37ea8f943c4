"""Pages that show motions with sound and words, or frames as they arrive, as one HTML document with three.js."""

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
from typing import Any, Literal, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, check_mono
from ha2g_jax.features.text import Word
from ha2g_jax.figure import view_of
from ha2g_jax.files.writing import write_text
from ha2g_jax.limits import MAX_MOTION_FRAMES
from ha2g_jax.motion.armature import export_axes
from ha2g_jax.motion.control.parts import rest_pose
from ha2g_jax.motion.cues.catalogue import GESTURES
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.windows import DEFAULT_HOP, DEFAULT_LOOK_AHEAD
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.viewer.packing import (
    LEVELS,
    PEAK_RATE,
    deflated,
    describe_skeleton,
    encode_sound,
    pack_body,
    pack_motion,
    peaks,
)

MAX_MOTIONS = 12
_FIGURE = ("motion.js", "body.js", "stage.js")
_SCRIPTS = (*_FIGURE, "timeline.js", "player.js")
_PARTS = ("arriving", "acting", "capture", "conversation", "live", "speaking", "watching")
_LIVE_SCRIPTS = (*_FIGURE, *(f"{name}.js" for name in _PARTS))
_DECIMALS = 4  # of directions
_MAX_SPEAKERS = 200


@dataclasses.dataclass(frozen=True)
class Page:
    """An HTML document, which a notebook shows as the result of a cell, in a frame of `height` pixels."""

    text: str = dataclasses.field(repr=False)
    height: int = 620

    def _repr_html_(self) -> str:
        style = f"width: 100%; height: {self.height}px; border: 0; border-radius: 10px"
        return f'<iframe style="{style}" allow="autoplay; fullscreen" srcdoc="{html.escape(self.text)}"></iframe>'

    def save(self, path: str | pathlib.Path) -> pathlib.Path:
        """Write the page to an `.html` file atomically, and return its path.

        Raises:
            UserError: the path does not end in `.html`, or the file cannot be written.
        """
        path = pathlib.Path(path)
        if path.suffix.lower() not in (".html", ".htm"):
            raise UserError(f"the viewer is an HTML page, not {path.name!r}; give a name that ends in .html")
        write_text(path, self.text)
        return path


def view(
    motions: Motion | Mapping[str, Motion],
    audio: np.ndarray | None = None,
    sample_rate: int = SAMPLE_RATE,
    words: Sequence[Word] = (),
    *,
    camera: str = "body",
    height: int = 620,
) -> Page:
    """Build a page that plays motions side by side with their sound and loads nothing from the network.

    `Page.save` writes it. The same input gives the same bytes.

    Args:
        motions: one motion, or several by name, in order from left to right.
        audio: (samples,) mono sound, floats or integers, see `features.audio.check_mono`; None for silence.
        camera: one of `figure.CAMERAS`, as for `write_video`.

    Raises:
        UserError: there is no motion, there are too many, or one is too long or not valid (see `Motion.check`), the
            sound or its rate cannot be used, or there is no such camera.
    """
    motions = {"": motions} if isinstance(motions, Motion) else dict(motions)
    _check(motions)
    if audio is not None:
        audio, sample_rate = check_mono(audio, sample_rate)
    duration = max(motion.num_frames / motion.fps for motion in motions.values())
    packed = [pack_body(motion.skeleton) for motion in motions.values()]
    bodies = [body for index, body in enumerate(packed) if packed.index(body) == index]
    content: dict[str, Any] = {
        "motions": [
            {"name": name, "body": bodies.index(body), **pack_motion(motion)}
            for (name, motion), body in zip(motions.items(), packed, strict=True)
        ],
        "bodies": bodies,
        "view": view_of(camera),
        "levels": LEVELS,
        "words": [[word.text, round(word.start, 3), round(word.end, 3)] for word in words],
        "sound": None,
    }
    if audio is not None and len(audio):
        # The player takes its time from the sound, so the sound lasts at least as long as the longest motion.
        padded = np.pad(audio, (0, max(0, round(duration * sample_rate) - len(audio))))
        duration = len(padded) / sample_rate
        content["sound"] = base64.b64encode(encode_sound(padded, sample_rate)).decode()
        content["peaks"], content["peakRate"] = peaks(padded, sample_rate), PEAK_RATE
    content["duration"] = duration
    title = ", ".join(filter(None, motions)) or "Motion"
    return Page(_build_document("page.html", title, content, ("style.css",), _SCRIPTS).text, height)


def _check(motions: Mapping[str, Motion]) -> None:
    if not 1 <= len(motions) <= MAX_MOTIONS:
        raise UserError(f"{len(motions)} motions for one page; expected 1 to {MAX_MOTIONS}, make several pages")
    for motion in motions.values():
        motion.check()
    frames = sum(motion.num_frames for motion in motions.values())
    if frames > MAX_MOTION_FRAMES:  # a page with this many has about 100 MB
        raise UserError(
            f"{frames} frames for one page; expected at most {MAX_MOTION_FRAMES}, cut the motion into parts"
        )


class _Document(NamedTuple):
    text: str
    style: str
    scripts: tuple[str, ...]


def _build_document(
    template: str, title: str, content: Mapping[str, Any], styles: Sequence[str], scripts: Sequence[str]
) -> _Document:
    """Fill a template of `assets/viewer` with styles, JSON values that the scripts read, and scripts in their order."""
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
    return _Document(text, style, code)


def _source_hash(text: str) -> str:
    """Return the source of a Content-Security-Policy that allows an element with a text, and no other."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def read_asset(name: str) -> str:
    """Return the text of a file of `assets/viewer`."""
    return (importlib.resources.files("ha2g_jax") / "assets" / "viewer" / name).read_text("utf-8")


@functools.cache
def _deflated_three() -> str:
    """Return three.js, release 130 with OrbitControls."""
    return deflated(read_asset("three.min.js").encode())


class LivePage(NamedTuple):
    """An HTML document in UTF-8 and its HTTP headers, which let the page connect only to its own origin."""

    content: bytes
    headers: dict[str, str]


def live_page(
    source: Literal["sound", "frames"],
    skeleton: Skeleton | None = None,
    fps: float = 0,
    *,
    speakers: Sequence[str] = (),
    needs_token: bool = False,
) -> LivePage:
    """Build the page that shows frames while they arrive.

    Args:
        source: "sound" for a page that sends sound to `/v1/stream` of its origin and shows the frames that it gets;
            "frames" for one that shows the frames that its origin sends, see `figure_message`.
        skeleton: skeleton of the frames; None if the server sends it.
    """
    content = {
        "source": source,
        "figure": None if skeleton is None else _figure(skeleton, fps),
        "speakers": list(speakers[:_MAX_SPEAKERS]),
        "cues": list(GESTURES),
        "needsToken": needs_token,
        "lookAhead": DEFAULT_LOOK_AHEAD,
        "hop": DEFAULT_HOP,
    }
    text, style, scripts = _build_document("live.html", "HA2G live", content, ("style.css", "live.css"), _LIVE_SCRIPTS)
    policy = {
        "default-src": "'none'",
        # three.js and the processor of sound are scripts that the page unpacks into blobs.
        "script-src": " ".join(("blob:", *map(_source_hash, scripts))),
        "style-src": _source_hash(style),
        "img-src": "data:",
        "connect-src": "'self'",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": "'none'",
    }
    return LivePage(
        text.encode(),
        {
            "Content-Type": "text/html; charset=utf-8",
            "Content-Security-Policy": "; ".join(f"{name} {value}" for name, value in policy.items()),
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cache-Control": "no-store",
        },
    )


def figure_message(skeleton: Skeleton, fps: float) -> dict[str, Any]:
    """Return the first message to a page of "frames", JSON values."""
    return {"figure": _figure(skeleton, fps)}


def frames_message(first: int, directions: np.ndarray) -> dict[str, Any]:
    """Return a message like those of `/v1/stream`, with frames (n, bones, 3) of unit vectors in the skeleton's axes."""
    rows = directions.reshape(len(directions), -1).astype(np.float64)
    return {"first": first, "frames": np.round(rows, _DECIMALS).tolist()}


def _figure(skeleton: Skeleton, fps: float) -> dict[str, Any]:
    """Return what the page needs to draw a skeleton; in its axes y is up, and the person faces +z."""
    return {
        "fps": fps,
        **describe_skeleton(skeleton),
        "body": pack_body(skeleton),
        "axes": export_axes(skeleton).tolist(),
        "rest": np.round(rest_pose(skeleton).reshape(-1).astype(np.float64), _DECIMALS).tolist(),
    }
