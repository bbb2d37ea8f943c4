"""Gestures of a LiveKit agent (tried with livekit-agents 1.8.9): an avatar that is drawn and published as video.

    async def entrypoint(context: JobContext):
        await context.connect()
        session = AgentSession(stt=..., llm=..., tts=...)
        avatar, _ = await start_avatar(session, context.room, ha2g_jax.load("demo").stream(look_ahead=4))
        await session.start(Agent(instructions="..."), room=context.room)
        session.input.audio = UserAudio(session.input.audio, avatar.body)

`Avatar` is what the `AvatarRunner` of LiveKit calls a video generator: it takes the agent's sound, and gives pictures
and sound in step. Draw a character of your own in `_draw`, or send the directions to the clients that draw it.
"""

import asyncio
import collections
from collections.abc import AsyncIterator

import numpy as np
from livekit import rtc
from livekit.agents import AgentSession, utils
from livekit.agents.voice.avatar import AudioSegmentEnd, AvatarOptions, AvatarRunner, QueueAudioOutput, VideoGenerator
from livekit.agents.voice.io import AudioInput

from ha2g_jax.apps.live.paced import PacedStream
from ha2g_jax.figure import DEFAULT_LOOK, View, draw_figure
from ha2g_jax.motion.motion import Motion
from ha2g_jax.synthesis import Stream

RATE, SIZE = 24000, 384  # of the agent's sound, and pixels of the video
VIEW = View(-0.85, -0.8, 0.85, 0.7)  # metres about the spine


class Avatar(VideoGenerator):
    """Lets a stream hear the agent and the user, and holds the agent's sound until its motion is shown."""

    def __init__(self, stream: Stream) -> None:
        self.body = PacedStream(stream, self._show)
        self._skeleton, self._fps = stream.skeleton, stream.fps
        self._pieces = utils.audio.AudioByteStream(RATE, 1, RATE // stream.fps)  # as long as a frame
        self._begun, self._count = -1.0, 0
        self._held: collections.deque[tuple[float, rtc.AudioFrame | AudioSegmentEnd]] = collections.deque()
        self._output: asyncio.Queue[rtc.VideoFrame | rtc.AudioFrame | AudioSegmentEnd | None] = asyncio.Queue()

    async def push_audio(self, frame: rtc.AudioFrame | AudioSegmentEnd) -> None:
        if isinstance(frame, AudioSegmentEnd):
            for piece in [*self._pieces.flush(), frame]:
                self._hold(piece)
        else:
            begun = self.body.say(bytes(frame.data), frame.sample_rate)
            if begun != self._begun:
                self._begun, self._count = begun, 0
            for piece in self._pieces.push(frame.data):
                self._hold(piece)

    def _hold(self, piece: rtc.AudioFrame | AudioSegmentEnd) -> None:
        # The first two pieces leave together, so that the player always has one.
        self._held.append((self._begun + max(self._count - 1, 0) / self._fps, piece))
        self._count += 1

    def clear_buffer(self) -> None:
        self._held.clear()
        self._pieces.clear()
        self._begun = -1.0
        self.body.clear()

    async def _show(self, number: int, directions: np.ndarray) -> None:
        if self._output.qsize() < self._fps:  # unless nobody takes them yet
            self._output.put_nowait(await asyncio.to_thread(self._draw, directions))
        while self._held and self._held[0][0] <= number / self._fps + 1e-6:
            self._output.put_nowait(self._held.popleft()[1])

    def _draw(self, directions: np.ndarray) -> rtc.VideoFrame:
        positions = Motion.from_directions(self._skeleton, directions[None], self._fps).positions[0]
        picture = draw_figure(positions, self._skeleton, DEFAULT_LOOK, SIZE, SIZE, VIEW)
        return rtc.VideoFrame(SIZE, SIZE, rtc.VideoBufferType.RGB24, picture.tobytes())

    async def __aiter__(self) -> AsyncIterator[rtc.VideoFrame | rtc.AudioFrame | AudioSegmentEnd]:
        task = asyncio.create_task(self.body.run())
        task.add_done_callback(lambda _: self._output.put_nowait(None))
        try:
            while (output := await self._output.get()) is not None:
                yield output
            await task  # which raises what ended it
        finally:
            task.cancel()


class UserAudio(AudioInput):
    """Passes the user's sound on to the session, and lets the avatar hear it."""

    def __init__(self, source: AudioInput, body: PacedStream) -> None:
        super().__init__(label="ha2g", source=source)
        self._body = body

    async def __anext__(self) -> rtc.AudioFrame:
        frame = await super().__anext__()
        self._body.hear(bytes(frame.data), frame.sample_rate)
        return frame


async def start_avatar(session: AgentSession, room: rtc.Room, stream: Stream) -> tuple[Avatar, AvatarRunner]:
    """Give the agent of a session an avatar in a room; call `aclose` of the runner at the end."""
    avatar, output = Avatar(stream), QueueAudioOutput(sample_rate=RATE)
    session.output.audio = output
    body = avatar.body
    session.on("agent_state_changed", lambda e: body.change(state="think" if e.new_state == "thinking" else "auto"))
    session.on("user_state_changed", lambda e: body.change(state="listen" if e.new_state == "speaking" else "auto"))
    options = AvatarOptions(SIZE, SIZE, stream.fps, RATE, audio_channels=1)
    runner = AvatarRunner(room, audio_recv=output, video_gen=avatar, options=options)
    await runner.start()
    return avatar, runner
