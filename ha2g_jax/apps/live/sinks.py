"""Sinks: where the frames of a live run go; JSON over UDP and WebSockets, the VMC protocol, and recordings."""

import contextlib
import json
import pathlib
import queue
import socket
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from tqdm import tqdm

from ha2g_jax.apps.live.frames import Frame
from ha2g_jax.apps.live.network import Address, read_address, serving, udp_target
from ha2g_jax.errors import UserError, require
from ha2g_jax.files.reading import resolved, shown
from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion.armature import Animation
from ha2g_jax.motion.formats.tables import describe_joints, describe_poses
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.rigs import OWN, load_rig
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.viewer.page import figure_message, frames_message, live_page

PAGE = "/page"  # where the page connects that the sink serves
_WAITING = 30  # messages that a page may be behind before it misses some
_SILENT = 2.0  # seconds after which a page that takes none of these messages is dropped
_POLL = 0.1  # seconds until a connection notices that the run has ended
_AGAIN = 1.0  # seconds between two descriptions of the joints, for receivers that start later
VMC_PORT, VMC_RIG = 39539, "unity"
_PORTS = {"vmc": VMC_PORT, "udp": None, "ws": None}  # default port by scheme
MAX_DATAGRAM = 1400  # bytes; a longer one is cut into packets on most networks, and lost as a whole with any of them

_MIRROR_X = np.array([-1.0, 1.0, 1.0])
_MIRROR_ROTATION = np.array([1.0, -1.0, -1.0, 1.0])
_HEADER, _SIZE = 16, 4  # bytes of a bundle, and of the size of a message in it


class Sink(Protocol):
    """A receiver of frames, at their times; its name is its address, its rig is what its frames need."""

    name: str
    rig: str

    def send(self, frame: Frame) -> None:
        """Send a frame without waiting.

        Raises:
            OSError: the frame cannot be sent; a later one may be.
        """
        ...


class UdpSink:
    """Sender of JSON in datagrams: the joints once a second, and each frame.

    Raises:
        UserError: the host is not known.
    """

    def __init__(self, address: Address, rig: str) -> None:
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
        self._socket.close()


class _Page:
    """A page that is connected to a sink.

    Attributes:
        messages: what it has not been sent yet.
        is_own: whether it is the page that the sink serves.
        full_since: time at which the messages were too many, None since it has taken one.
    """

    def __init__(self, connection: Any) -> None:
        self._connection, self.is_own = connection, connection.request.path == PAGE
        self._host, self._port, *_ = connection.remote_address
        self.messages = queue.Queue[str](_WAITING)
        self.full_since: float | None = None

    def send(self, text: str) -> None:
        """Send a message, and wait until the network has taken it."""
        self._connection.send(text)
        self.full_since = None

    def put(self, text: str) -> bool:
        """Queue a message, or leave it out if too many wait; return whether the page still reads."""
        with contextlib.suppress(queue.Full):
            self.messages.put_nowait(text)
            return True
        now = time.monotonic()
        since = self.full_since = self.full_since or now  # which `send` may reset at any time
        return now - since < _SILENT

    def drop(self, sink: str) -> None:
        """End the connection, for which a thread may be waiting, and say so."""
        with contextlib.suppress(OSError):
            self._connection.socket.shutdown(socket.SHUT_RDWR)
        tqdm.write(f"{sink} drops the page at {self._host}, port {self._port}, which does not read", file=sys.stderr)


class WebSocketSink:
    """Server that sends JSON to every page that connects: the joints first, then the frames.

    The page that is served at the same address, which connects to `PAGE`, gets messages of `viewer.page` instead.
    A page that reads too slowly misses frames, and one that does not read is dropped; neither the run nor other pages
    wait for it.
    """

    def __init__(self, address: Address, rig: str) -> None:
        self.name, self.rig = str(address), rig
        self._lock, self._pages = threading.Lock(), set[_Page]()
        self._greetings, self._is_closed = ("", ""), False

    def serve(self, connection: Any) -> None:
        """Send messages to a page until it leaves or the run ends."""
        page, is_greeted = _Page(connection), False
        with self._lock:
            self._pages.add(page)
        try:
            while connection.close_code is None and not (self._is_closed and page.messages.empty()):
                with contextlib.suppress(queue.Empty):
                    message = page.messages.get(timeout=_POLL)
                    if not is_greeted:
                        page.send(self._greetings[page.is_own])
                        is_greeted = True
                    page.send(message)
        finally:
            with self._lock:
                self._pages.discard(page)

    def send(self, frame: Frame) -> None:
        animation = frame.animations[self.rig]
        if not all(self._greetings):
            figure = _json(figure_message(frame.skeleton, animation.fps))
            self._greetings = (joints_message(animation), figure)
        with self._lock:
            pages = tuple(self._pages)
        kinds = {page.is_own for page in pages}
        texts = {False: frame_message(frame, animation)} if False in kinds else {}
        if True in kinds:
            texts[True] = _json(frames_message(frame.number, frame.directions[None]))
        self._drop(page for page in pages if not page.put(texts[page.is_own]))

    def close(self) -> None:
        """Let the connections end when they have sent what is queued; drop those that take longer."""
        self._is_closed = True
        end = time.monotonic() + _SILENT
        while self._pages and time.monotonic() < end:
            time.sleep(_POLL)
        self._drop(tuple(self._pages))

    def _drop(self, pages: Iterable[_Page]) -> None:
        for page in pages:
            with self._lock:
                self._pages.discard(page)
            page.drop(self.name)


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
    """All frames of a run, for an `.npz` that is written to a temporary path at its end."""

    def __init__(self, temporary: pathlib.Path) -> None:
        self.temporary = temporary
        self._frames: list[np.ndarray] = []

    def add(self, directions: np.ndarray) -> None:
        """Append a copy of frames (n, bones, 3)."""
        if len(directions):
            self._frames.append(directions.copy())

    def save(self, skeleton: Skeleton, fps: float, meta: dict[str, Any]) -> None:
        Motion.from_directions(skeleton, np.concatenate(self._frames), fps, meta).save(self.temporary)


class Sinks(NamedTuple):
    """Where the frames go: senders take them one by one at their times, recordings all of them."""

    senders: tuple[Sink, ...]
    recordings: tuple[Recording, ...]


class VmcSink:
    """Sender of frames with the rig `unity` by the VMC protocol: OSC messages over UDP (protocol.vmc.info).

    It moves a VRM or Unity humanoid. Axes are those of Unity: left-handed, metres, y up, the figure faces +z, its left
    is at -x. Bones have the names of Unity's HumanBodyBones; positions and rotations are relative to the parent, and
    a rotation is the identity in the T-pose.

    Raises:
        UserError: the host is not known, or the library is missing.
    """

    rig = VMC_RIG

    def __init__(self, address: Address) -> None:
        self._messages = require("pythonosc.osc_message_builder", "live", package="python-osc")
        self._bundles = require("pythonosc.osc_bundle_builder", "live", package="python-osc")
        self.name = str(address)
        self._socket, self._target = udp_target(address)

    def send(self, frame: Frame) -> None:
        """Send /VMC/Ext/OK, /VMC/Ext/T, /VMC/Ext/Root/Pos and a /VMC/Ext/Bone/Pos for each bone."""
        for datagram in self._datagrams(frame):
            self._socket.sendto(datagram, self._target)

    def close(self) -> None:
        self._socket.close()

    def _datagrams(self, frame: Frame) -> Iterator[bytes]:
        """Yield bundles of at most `MAX_DATAGRAM` bytes."""
        messages, size = [], _HEADER
        for message in self._frame_messages(frame):
            if messages and size + _SIZE + message.size > MAX_DATAGRAM:
                yield self._bundle(messages)
                messages, size = [], _HEADER
            messages.append(message)
            size += _SIZE + message.size
        yield self._bundle(messages)

    def _frame_messages(self, frame: Frame) -> Iterator:
        animation = frame.animations[VMC_RIG]
        armature = animation.armature
        yield self._message("/VMC/Ext/OK", 1)
        yield self._message("/VMC/Ext/T", float(frame.seconds))
        yield self._message("/VMC/Ext/Root/Pos", "root", *(0.0, 0.0, 0.0), *(0.0, 0.0, 0.0, 1.0))
        positions = np.concatenate([animation.translation, armature.offsets[1:]]) * _MIRROR_X + 0.0
        rotations = animation.rotations[0] * _MIRROR_ROTATION + 0.0
        for name, position, rotation in zip(armature.joints, positions.tolist(), rotations.tolist(), strict=True):
            yield self._message("/VMC/Ext/Bone/Pos", name, *position, *rotation)

    def _message(self, address: str, *values: int | float | str):
        builder = self._messages.OscMessageBuilder(address)
        for value in values:
            builder.add_arg(value)
        return builder.build()

    def _bundle(self, messages: list) -> bytes:
        builder = self._bundles.OscBundleBuilder(self._bundles.IMMEDIATELY)
        for message in messages:
            builder.add_content(message)
        return builder.build().dgram


def open_sinks(texts: Sequence[str], stack: contextlib.ExitStack, rig: str = OWN) -> Sinks:
    """Open sinks.

    Args:
        texts: vmc://HOST[:PORT], udp://HOST:PORT, ws://HOST:PORT to listen on, or a file .npz to write.
        stack: closes the sinks; the files are complete if it is left without an exception, and not written otherwise.
        rig: rig of JSON, one of `motion.rigs.RIGS`.

    Raises:
        UserError: there is no sink, one is not known or cannot be used, or there is no such rig.
    """
    if not texts:
        raise UserError("no sink; give at least one with --sink, such as vmc://127.0.0.1:39539")
    load_rig(rig)
    targets = [*map(_target, texts)]
    if len(set(targets)) < len(targets):
        raise UserError("two sinks are the same; give each once")
    senders, recordings = list[Sink](), list[Recording]()
    for target in targets:
        if not isinstance(target, Address):
            recordings.append(Recording(stack.enter_context(whole_file(target))))
        elif target.scheme == "vmc":
            senders.append(stack.enter_context(contextlib.closing(VmcSink(target))))
        elif target.scheme == "udp":
            senders.append(stack.enter_context(contextlib.closing(UdpSink(target, rig))))
        else:
            pages = WebSocketSink(target, rig)
            stack.enter_context(serving(target, pages.serve, live_page("frames")))
            tqdm.write(f"watch at {target._replace(scheme='http')}", file=sys.stderr)
            senders.append(stack.enter_context(contextlib.closing(pages)))
    return Sinks(tuple(senders), tuple(recordings))


def _target(text: str) -> Address | pathlib.Path:
    """Return the address or the file of a sink, which is the same for all spellings."""
    scheme = text.partition("://")[0].lower() if "://" in text else ""
    if scheme in _PORTS:
        return read_address(text, _PORTS[scheme])
    if scheme or pathlib.Path(text).suffix.lower() != ".npz":
        raise UserError(
            f"no sink {shown(text)}; expected vmc://HOST:PORT, udp://HOST:PORT, ws://HOST:PORT or a file .npz"
        )
    return resolved(text)
