"""The route `/v1/stream`: a WebSocket on which sound comes in and frames go out, see docs/serving.md.

A message is computed and its frames are sent before the next one is received, so that nothing piles up: a client that
sends faster than the machine computes, or does not read its frames, is held up by TCP.
"""

import asyncio
import json
import logging
import time
from typing import Any, NamedTuple

import numpy as np
import soxr
from fastapi import APIRouter, Response, WebSocket, WebSocketDisconnect

from ha2g_jax.apps.serve.guard import refusal
from ha2g_jax.apps.serve.messages import Begin, Change, read_message
from ha2g_jax.apps.serve.service import Full, Service, Stopped
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.synthesis.stream import Stream
from ha2g_jax.viewer.page import frames_message

_RETRY_SECONDS = 10
_PIECE_SECONDS = 0.2  # of sound that is computed at once, so that streams take turns
_CLOSE_SECONDS = 5

# Codes of the close of a WebSocket (RFC 6455).
DONE, BAD_MESSAGE, LIMIT, ERROR, STOPPED = 1000, 1007, 1008, 1011, 1012

_logger = logging.getLogger(__name__)


class _Limit(Exception):
    """A limit of a session is reached; the message says which."""


def router(service: Service) -> APIRouter:
    """Return the route of a service."""
    routes = APIRouter()

    @routes.websocket("/v1/stream")
    async def stream(websocket: WebSocket) -> None:
        try:
            with service.sessions.take():
                await websocket.accept()
                await _converse(service, websocket)
        except Full:
            await websocket.send_denial_response(_full(service))

    @routes.get("/v1/stream", include_in_schema=False)
    async def reason() -> Response:
        """Tell why a stream would be refused, as pages do not see the answer to a WebSocket that is refused."""
        if service.sessions.are_taken:
            return _full(service)
        answer = refusal(426, "this is the address of a WebSocket")
        answer.headers["Upgrade"] = "websocket"
        return answer

    return routes


def _full(service: Service) -> Response:
    return refusal(503, f"{service.settings.sessions} streams are running; try again later", _RETRY_SECONDS)


class Session(NamedTuple):
    """A stream and the sound that goes into it.

    Attributes:
        channels: 1, the agent, or 2, with the other.
        resampler: from the rate of the client to 16 kHz, None if the client sends 16 kHz.
    """

    stream: Stream
    channels: int
    resampler: soxr.ResampleStream | None

    @classmethod
    def begin(cls, service: Service, asked: Begin) -> "Session":
        """Begin a session; the generator is compiled before this returns.

        Raises:
            UserError: the model cannot be streamed from, or a value cannot be used.
        """
        stream = service.model.stream(
            look_ahead=asked.look_ahead,
            hop=asked.hop,
            seed=asked.seed,
            style=asked.style.style(),
            controls=asked.controls.controls(),
        )
        stream.muted, stream.state = asked.muted, asked.state
        is_equal = asked.rate == SAMPLE_RATE
        resampler = None if is_equal else soxr.ResampleStream(asked.rate, SAMPLE_RATE, asked.channels, "float32", "HQ")
        return cls(stream, asked.channels, resampler)

    def feed(self, pcm: np.ndarray) -> np.ndarray:
        """Return the frames that became final with samples (samples, channels) of 16 bits: the agent, and the other."""
        samples = pcm.astype(np.float32) / 32768
        return self.stream.feed(*(samples if self.resampler is None else self.resampler.resample_chunk(samples)).T)

    def end_sound(self) -> np.ndarray:
        """Return the frames that became final with the milliseconds that the resampler holds back, and reset it."""
        if self.resampler is None:
            return self.stream.feed(np.zeros(0, np.float32))
        rest = self.resampler.resample_chunk(np.zeros((0, self.channels), np.float32), last=True)
        self.resampler.clear()
        return self.stream.feed(*rest.T)

    def change(self, asked: Change) -> tuple[np.ndarray, int | None]:
        """Make the requested changes.

        Returns:
            The frames that became final before speech was dropped, and the number of the next frame if it was.

        Raises:
            UserError: a value cannot be used; nothing has changed.
        """
        cue, stream = asked.asked_cue(), self.stream
        before = stream.style, stream.controls
        frames, first = np.zeros((0, 0, 3), np.float32), None
        try:
            if asked.style is not None:
                stream.style = asked.style.style()
            if asked.controls is not None:
                stream.controls = asked.controls.controls()
            if asked.clear is True:  # what the resampler holds back becomes silence, too
                frames, first = self.end_sound(), stream.clear()
            elif asked.clear is not None:
                first = stream.clear(asked.clear)
                if self.resampler is not None:
                    self.resampler.clear()
            if cue is not None:  # after a clear none waits, and there is space for it
                stream.cue(cue)
        except UserError:
            stream.style, stream.controls = before
            raise
        stream.muted = stream.muted if asked.muted is None else asked.muted
        stream.state = stream.state if asked.state is None else asked.state
        return frames, first


async def _converse(service: Service, websocket: WebSocket) -> None:
    """Serve a stream to its end, and close it with a code that says how it ended."""
    code, text = DONE, None
    try:
        async with asyncio.timeout(service.settings.session_seconds):
            await service.run(_run(service, websocket))
    except WebSocketDisconnect:
        return
    except UserError as error:
        code, text = BAD_MESSAGE, str(error)
    except _Limit as error:
        code, text = LIMIT, str(error)
    except TimeoutError:
        code, text = LIMIT, f"the stream has lasted {service.settings.session_seconds:g} s; begin another one"
    except Stopped:
        code, text = STOPPED, "the service has been stopped; begin another stream later"
    except Exception:
        _logger.exception("a stream has failed")
        code, text = ERROR, "an error of the service; begin another stream"
    if text is not None:
        service.counters.errors.labels(code).inc()
    try:
        async with asyncio.timeout(_CLOSE_SECONDS):
            if text is not None:
                await websocket.send_text(json.dumps({"error": text}))
            await websocket.close(code)
    except (TimeoutError, RuntimeError, WebSocketDisconnect):  # the client is gone, or does not read
        return


async def _run(service: Service, websocket: WebSocket) -> None:
    first = await _receive(service, websocket)
    if isinstance(first, bytes):
        raise UserError('the first message is binary; expected JSON, such as {"look_ahead": 8}')
    asked = read_message(Begin, first)
    session = await service.compute(Session.begin, service, asked)
    stream, sent = session.stream, 0
    facts = {"fps": stream.fps, "skeleton": stream.skeleton.name, "bones": stream.skeleton.num_bones}
    timing = {"look_ahead": stream.look_ahead, "hop": stream.hop, "latency": round(stream.latency, 4)}
    await _send(service, websocket, facts | timing)
    while True:
        message = await _receive(service, websocket)
        if isinstance(message, str):
            try:
                change = read_message(Change, message)
                frames, first = await service.compute(session.change, change)
            except UserError as error:
                await _send(service, websocket, {"error": str(error)})
                continue
            sent = await _send_frames(service, websocket, sent, frames)
            if first is not None:
                sent = first
                await _send(service, websocket, {"cleared": True, "first": first})
            if change.end:
                break
            continue
        if len(message) % (2 * asked.channels):
            raise UserError(f"a message of {len(message)} bytes; expected whole samples of 16 bits")
        pcm = np.frombuffer(message, "<i2").reshape(-1, asked.channels)
        length = round(asked.rate * _PIECE_SECONDS)
        for start in range(0, len(pcm), length):
            begun = time.monotonic()
            frames = await service.compute(session.feed, pcm[start : start + length])
            service.counters.feed_seconds.observe(time.monotonic() - begun)
            sent = await _send_frames(service, websocket, sent, frames)
    sent = await _send_frames(service, websocket, sent, await service.compute(session.end_sound))
    sent = await _send_frames(service, websocket, sent, await service.compute(stream.flush))
    await _send(service, websocket, {"end": True, "count": sent})


async def _receive(service: Service, websocket: WebSocket) -> str | bytes:
    idle = service.settings.idle_seconds
    try:
        async with asyncio.timeout(idle):
            message = await websocket.receive()
    except TimeoutError:
        raise _Limit(f"no message for {idle:g} s; send silence to keep a stream") from None
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1005))
    text = message.get("text")
    return message["bytes"] if text is None else text


async def _send(service: Service, websocket: WebSocket, message: dict[str, Any]) -> None:
    idle = service.settings.idle_seconds
    try:
        async with asyncio.timeout(idle):
            await websocket.send_text(json.dumps(message, separators=(",", ":")))
    except TimeoutError:
        raise _Limit(f"frames were not read for {idle:g} s") from None


async def _send_frames(service: Service, websocket: WebSocket, sent: int, frames: np.ndarray) -> int:
    """Send frames (n, bones, 3) if there are any, and return the number of all that were sent."""
    if len(frames):
        await _send(service, websocket, frames_message(sent, frames))
        service.counters.frames.inc(len(frames))
    return sent + len(frames)
