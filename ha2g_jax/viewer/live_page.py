"""The page that shows frames while they arrive, as a server answers with it."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from ha2g_jax.motion.armature import export_axes
from ha2g_jax.motion.control.parts import rest_pose
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.viewer.packing import describe_skeleton
from ha2g_jax.viewer.page import build_document, source_hash

_SCRIPTS = (
    *("motion.js", "loft.js", "head.js", "arm.js", "body.js", "stage.js"),
    *("arriving.js", "capture.js", "conversation.js", "live.js", "speaking.js", "watching.js"),
)
_DECIMALS = 4
_MAX_SPEAKERS = 200


class LivePage(NamedTuple):
    """An HTML document in UTF-8 and its headers of HTTP, by which the page may connect to its own origin only."""

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
    """Build the page.

    Args:
        source: "sound" for a page that sends sound to `/v1/stream` of its origin and shows the frames that it gets;
            "frames" for one that shows the frames that its origin sends, see `figure_message`.
        skeleton: skeleton of the frames; None if the server sends it.
    """
    content = {
        "source": source,
        "figure": None if skeleton is None else _figure(skeleton, fps),
        "speakers": list(speakers[:_MAX_SPEAKERS]),
        "needsToken": needs_token,
    }
    text, style, scripts = build_document("live.html", "HA2G live", content, ("style.css", "live.css"), _SCRIPTS)
    policy = {
        "default-src": "'none'",
        # three.js and the processor of sound are scripts that the page unpacks into blobs.
        "script-src": " ".join(("blob:", *map(source_hash, scripts))),
        "style-src": source_hash(style),
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
    """Return a message with frames, JSON values; it has the form of those of `/v1/stream`.

    Args:
        directions: (n, bones, 3) unit vectors in the axes of the skeleton.
    """
    rows = directions.reshape(len(directions), -1).astype(np.float64)
    return {"first": first, "frames": np.round(rows, _DECIMALS).tolist()}


def _figure(skeleton: Skeleton, fps: float) -> dict[str, Any]:
    """Return what the page needs to draw a skeleton: y is up there, and the person faces +z."""
    return {
        "fps": fps,
        **describe_skeleton(skeleton),
        "axes": export_axes(skeleton).tolist(),
        "rest": np.round(rest_pose(skeleton).reshape(-1).astype(np.float64), _DECIMALS).tolist(),
    }
