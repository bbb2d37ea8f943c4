"""Gestures of a Pipecat agent, tried with pipecat-ai 1.14.0.

    python examples/agents/pipecat_agent.py demo    # an agent without network services, at ws://127.0.0.1:8765

`Gestures` stands between the speech service of a pipeline and the output of its transport. It sends each frame of the
motion at its time as a message of the transport, of the form that a page gets from `ha2g serve` (docs/serving.md), and
passes the agent's sound on when its motion is shown, after the latency of the stream.
"""

import asyncio
import collections
import itertools
import sys
from collections.abc import AsyncGenerator

import numpy as np
from pipecat.audio.vad.silero import SileroVADAnalyzer
from pipecat.frames import frames
from pipecat.pipeline.pipeline import Pipeline
from pipecat.pipeline.worker import PipelineWorker
from pipecat.processors.audio.vad_processor import VADProcessor
from pipecat.processors.frame_processor import FrameDirection, FrameProcessor
from pipecat.serializers.protobuf import ProtobufFrameSerializer
from pipecat.services.settings import TTSSettings
from pipecat.services.tts_service import TTSService
from pipecat.transports.websocket import server
from pipecat.turns.user_stop import SpeechTimeoutUserTurnStopStrategy
from pipecat.turns.user_turn_processor import UserTurnProcessor
from pipecat.turns.user_turn_strategies import UserTurnStrategies
from pipecat.workers.runner import WorkerRunner

import ha2g_jax
from ha2g_jax.apps.live.paced import PacedStream
from ha2g_jax.features import espeak
from ha2g_jax.synthesis import Stream

STATES = {
    frames.UserStartedSpeakingFrame: "listen",
    frames.UserStoppedSpeakingFrame: "auto",
    frames.LLMFullResponseStartFrame: "think",
}
ANSWERS = ("That is a good question, and there are two answers to it.", "Tell me more about the other one, please.")
VOICE = espeak.Voice("en-us", "f2", pitch=40, pitch_range=60, rate=160)


class Gestures(FrameProcessor):
    """Lets a stream hear the agent and the user, and holds the agent's sound until its motion is shown."""

    def __init__(self, stream: Stream) -> None:
        super().__init__()
        self._body, self._fps, self._task = PacedStream(stream, self._show), stream.fps, None
        self._held: collections.deque[tuple[float, frames.Frame]] = collections.deque()  # with times of the motion
        self._begun = 0.0

    async def process_frame(self, frame: frames.Frame, direction: FrameDirection) -> None:
        await super().process_frame(frame, direction)
        if state := STATES.get(type(frame)):
            self._body.change(state=state)
        if isinstance(frame, frames.StartFrame):
            self._task = self.create_task(self._body.run())
        elif isinstance(frame, frames.InputAudioRawFrame):
            self._body.hear(frame.audio, frame.sample_rate)
        elif isinstance(frame, frames.InterruptionFrame):
            self._held = collections.deque(held for held in self._held if not held[1].interruptible)
            self._body.clear()
        elif isinstance(frame, frames.TTSAudioRawFrame):
            self._begun = self._body.say(frame.audio, frame.sample_rate)
        is_ordered = direction is FrameDirection.DOWNSTREAM and not isinstance(frame, frames.SystemFrame)
        if isinstance(frame, frames.TTSAudioRawFrame) or (self._held and is_ordered):
            self._held.append((self._begun, frame))
        else:
            await self.push_frame(frame, direction)

    async def _show(self, number: int, directions: np.ndarray) -> None:
        message = {"first": number, "frames": [directions.ravel().round(4).tolist()]}
        await self.push_frame(frames.OutputTransportMessageUrgentFrame(message=message))
        while self._held and self._held[0][0] <= number / self._fps:
            await self.push_frame(self._held.popleft()[1])

    async def cleanup(self) -> None:
        await super().cleanup()
        if self._task:
            await self.cancel_task(self._task)


class EspeakVoice(TTSService):
    """Speech of espeak-ng."""

    def __init__(self) -> None:
        settings = TTSSettings(model=None, voice=None, language=None)
        super().__init__(push_start_frame=True, push_stop_frames=True, settings=settings)

    async def run_tts(self, text: str, context_id: str) -> AsyncGenerator[frames.Frame | None, None]:
        speech = await asyncio.to_thread(espeak.say, text, VOICE)
        pcm = (32767 * speech.audio.clip(-1, 1)).astype("<i2").tobytes()
        yield frames.TTSAudioRawFrame(pcm, 16000, 1, context_id=context_id)


async def serve(stream: Stream, port: int = 8765) -> None:
    """Run an agent that answers whenever the user has spoken, until it is stopped."""
    parameters = server.SingleClientWebsocketServerParams(
        audio_in_enabled=True, audio_out_enabled=True, serializer=ProtobufFrameSerializer()
    )
    transport = server.SingleClientWebsocketServerTransport(parameters, host="127.0.0.1", port=port)
    stop = SpeechTimeoutUserTurnStopStrategy(wait_for_transcript=False)
    turns = UserTurnProcessor(user_turn_strategies=UserTurnStrategies(stop=[stop]))
    voice_activity = VADProcessor(vad_analyzer=SileroVADAnalyzer())
    parts = [transport.input(), voice_activity, turns, EspeakVoice(), Gestures(stream), transport.output()]
    worker, answers = PipelineWorker(Pipeline(parts)), itertools.cycle(ANSWERS)

    @turns.event_handler("on_user_turn_stopped")
    async def answer(*_: object) -> None:
        await worker.queue_frame(frames.TTSSpeakFrame(next(answers)))

    runner = WorkerRunner()
    await runner.add_workers(worker)
    await runner.run()


if __name__ == "__main__":
    asyncio.run(serve(ha2g_jax.load(sys.argv[1]).stream(look_ahead=4)))
