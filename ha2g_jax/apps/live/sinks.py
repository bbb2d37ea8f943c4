"""Sinks: where the frames of a live run go; JSON over UDP and WebSockets, and recordings."""

import contextlib
import json
import pathlib
import queue
import threading
from typing import Any, NamedTuple, Protocol

import numpy as np

from ha2g_jax.apps.live.addresses import Address, udp_target
from ha2g_jax.apps.live.frames import Frame
from ha2g_jax.motion.armature import Animation
from ha2g_jax.motion.formats.tables import describe_joints, describe_poses
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.viewer.live_page import figure_message, frames_message

PAGE = "/page"  # where the page connects that the sink serves
_WAITING = 30  # messages that a page may be behind before it misses some
_POLL = 0.1  # seconds until a connection notices that the run has ended
_AGAIN = 1.0  # seconds between two descriptions of the joints, for receivers that start later


class Sink(Protocol):
    """A receiver of frames, at their times.

    Attributes:
        name: its address, for messages.
        rig: name of the rig that its frames need.
    """

    name: str
    rig: str

    def send(self, frame: Frame) -> None:
        """Send a frame without waiting.

        Raises:
            OSError: the frame cannot be sent; a later one may be.
        """
        ...


class UdpSink:
    """Sender of JSON in datagrams: the joints once a second, and each frame."""

    def __init__(self, address: Address, rig: str) -> None:
        """Prepare a socket; nothing is sent yet.

        Args:
            address: where the receiver listens.
            rig: name of the rig.

        Raises:
            UserError: the host is not known.
        """
        self.name, self.rig = str(address), rig
        self._socket, self._target = udp_target(address)
        self._next_joints = 0.0

    def send(self, frame: Frame) -> None:
        animation = frame.animations[self.rig]
        if frame.seconds >= self._next_joints:
            self._next_joints = frame.seconds + _AGAIN
            self._socket.sendto(joints_message(animation).encode(), self._target)
        self._socket.sendto(frame_message(frame, animation).encode(), self._target)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class WebSocketSink:
    """Server that sends JSON to every page that connects: the joints first, then the frames.

    The page that is served at the same address, which connects to `PAGE`, gets messages of `viewer.live_page` instead.
    A page that reads too slowly misses frames; neither the run nor other pages wait for it.
    """

    def __init__(self, address: Address, rig: str) -> None:
        """Start without pages.

        Args:
            address: where pages connect.
            rig: name of the rig.
        """
        self.name, self.rig = str(address), rig
        self._lock, self._pages = threading.Lock(), list[tuple[queue.Queue[str], bool]]()
        self._greetings, self._is_closed = ("", ""), False

    def serve(self, connection: Any) -> None:
        """Send messages to a page until it leaves or the run ends."""
        messages, is_own = queue.Queue[str](_WAITING), connection.request.path == PAGE
        is_greeted = False
        with self._lock:
            self._pages.append((messages, is_own))
        try:
            while connection.close_code is None and not (self._is_closed and messages.empty()):
                with contextlib.suppress(queue.Empty):
                    message = messages.get(timeout=_POLL)
                    if not is_greeted:
                        connection.send(self._greetings[is_own])
                        is_greeted = True
                    connection.send(message)
        finally:
            with self._lock:
                self._pages.remove((messages, is_own))

    def send(self, frame: Frame) -> None:
        animation = frame.animations[self.rig]
        if not all(self._greetings):
            figure = _json(figure_message(frame.skeleton, animation.fps))
            self._greetings = (joints_message(animation), figure)
        with self._lock:
            pages = tuple(self._pages)
        kinds = {is_own for _, is_own in pages}
        texts = {False: frame_message(frame, animation)} if False in kinds else {}
        if True in kinds:
            texts[True] = _json(frames_message(frame.number, frame.directions[None]))
        for messages, is_own in pages:
            with contextlib.suppress(queue.Full):
                messages.put_nowait(texts[is_own])

    def close(self) -> None:
        """Let the connections end when they have sent what waits."""
        self._is_closed = True


def joints_message(animation: Animation) -> str:
    """Return {"type": "joints", ...} with the fields of `formats.tables.describe_joints`, in JSON."""
    return _json({"type": "joints", **describe_joints(animation.armature, animation.fps)})


def frame_message(frame: Frame, animation: Animation) -> str:
    """Return {"type": "frame", "frame": number, "time": seconds, ...} with the fields of a pose of `formats.tables`."""
    head = {"type": "frame", "frame": frame.number, "time": round(frame.seconds, 6)}
    return _json(head | next(describe_poses(animation)))


def _json(message: dict[str, Any]) -> str:
    return json.dumps(message, separators=(",", ":"))


class Recording:
    """All frames of a run, for an `.npz` that is written at its end.

    Attributes:
        temporary: path that the file is written to, and renamed from when it is complete.
    """

    def __init__(self, temporary: pathlib.Path) -> None:
        """Start without frames."""
        self.temporary = temporary
        self._frames: list[np.ndarray] = []

    def add(self, directions: np.ndarray) -> None:
        """Append a copy of frames (n, bones, 3)."""
        if len(directions):
            self._frames.append(directions.copy())

    def save(self, skeleton: Skeleton, fps: float, meta: dict[str, Any]) -> None:
        """Write the motion of all frames.

        Args:
            skeleton: skeleton of the frames.
            fps: frames per second.
            meta: entries of `Motion.meta`.
        """
        Motion.from_directions(skeleton, np.concatenate(self._frames), fps, meta).save(self.temporary)


class Sinks(NamedTuple):
    """Where the frames go: senders take them one by one at their times, recordings all of them."""

    senders: tuple[Sink, ...]
    recordings: tuple[Recording, ...]
