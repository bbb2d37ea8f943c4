"""The recipes of examples/agents, run with Pipecat and LiveKit Agents on loopback; skipped where these are missing."""

import asyncio
import importlib
import itertools
import json
import pathlib
import shutil
import socket
import subprocess
import time

import numpy as np
import pytest

from ha2g_jax.features import espeak
from ha2g_jax.features.audio import SAMPLE_RATE

EXAMPLES = pathlib.Path(__file__).parent.parent / "examples" / "agents"
USER = espeak.Voice("en", "m3", pitch=50, pitch_range=60, rate=160)
AGENT = espeak.Voice("en-us", "f2", pitch=40, pitch_range=60, rate=160)
IN_STEP = 0.3  # seconds between a sound and its frame
LIVEKIT_RATE = 24000
PIECE = 320  # samples of the user that are sent at once

pytestmark = pytest.mark.filterwarnings("default")  # of libraries of others


def example(name, library, monkeypatch):
    pytest.importorskip(library)
    monkeypatch.syspath_prepend(EXAMPLES)
    return importlib.import_module(name)


def pcm(text, voice):
    return (32767 * espeak.say(text, voice).audio).astype("<i2")


class Watched:
    """A stream that notes what it is told, and the sound of the agent that it hears."""

    def __init__(self, stream):
        object.__setattr__(self, "stream", stream)
        object.__setattr__(self, "told", [])
        object.__setattr__(self, "own", np.zeros(0, np.float32))
        object.__setattr__(self, "has_heard_other", False)

    def __getattr__(self, name):
        return getattr(self.stream, name)

    def __setattr__(self, name, value):
        self.told.append(value)
        setattr(self.stream, name, value)

    def feed(self, own, other):
        object.__setattr__(self, "own", np.append(self.own, own))
        object.__setattr__(self, "has_heard_other", self.has_heard_other or other.any())
        return self.stream.feed(own, other)

    def clear(self):
        self.told.append("clear")
        self.stream.clear()

    def onsets(self):
        """Return the first frames (n,) of the agent's sounds."""
        frames = np.flatnonzero(np.abs(self.own) > 0.01) * self.fps // SAMPLE_RATE
        return frames[np.diff(frames, prepend=-self.fps) > self.fps // 2]


def runs(times, pause=0.4):
    """Return first and last of times (n,) between pauses."""
    starts = np.flatnonzero(np.diff(times, prepend=-np.inf) > pause)
    return [(times[a], times[b - 1]) for a, b in itertools.pairwise([*starts, len(times)])]


TWO_SENDERS = """
const sockets = [], timers = [];
globalThis.WebSocket = class extends EventTarget {
  static OPEN = 1;
  readyState = 0;
  sent = [];
  constructor() { super(); sockets.push(this); }
  send(message) { this.sent.push(JSON.parse(message)); }
  open() { this.readyState = 1; this.onopen(); }
  close() { this.readyState = 3; this.dispatchEvent(new Event("close")); }
};
globalThis.setTimeout = (callback, _, ...given) => timers.push(() => callback(...given));
const pass = () => timers.splice(0).forEach((timer) => timer());
const body = new Body();
body.tell("before");
sockets[0].open();
body.tell("refused");
sockets[0].close();
pass();
sockets.at(-1).open();
pass();
sockets.at(-1).close();
body.tell("stale");
pass();
sockets.at(-1).open();
console.log(JSON.stringify(sockets.map(({ sent }) => sent)));
"""


LONG_SPEECH = """
const sent = [];
globalThis.WebSocket = class extends EventTarget {
  static OPEN = 1;
  readyState = 1;
  send(message) { sent.push(message.byteLength); }
};
new Body().say(new Int16Array(600000));
console.log(JSON.stringify(sent));
"""

REUSED = """
const sockets = [], sent = [];
globalThis.WebSocket = class extends EventTarget {
  static OPEN = 1;
  constructor() { super(); sockets.push(this); }
  send(message) { sent.push([...message]); }
};
const body = new Body(), buffer = new Int16Array(2);
for (const value of [1, 2]) body.say(buffer.fill(value));
sockets[0].onopen();
console.log(JSON.stringify(sent));
"""


POSED = """
const sockets = [];
globalThis.WebSocket = class extends EventTarget { constructor() { super(); sockets.push(this); } };
const body = new Body();
const poses = [[...body.pose]];
const send = (message) => sockets[1].onmessage({ data: JSON.stringify(message) });
send({ type: "joints", joints: [{ name: "hips" }, { name: "spine" }, { name: "none" }] });
send({ type: "frame", rotations: [[0, 0, 0, 1], [0.5, 0.5, -0.5, 0.5], [1, 0, 0, 0]] });
for (const metaVersion of ["0", "1"]) {
  const found = {};
  const bone = (name) => ({ quaternion: { set: (...values) => (found[name] = values) } });
  const getNormalizedBoneNode = (name) => (name === "none" ? null : bone(name));
  body.poseVrm({ meta: { metaVersion }, humanoid: { getNormalizedBoneNode } });
  poses.push(found);
}
console.log(JSON.stringify([...poses, [...body.pose]]));
"""


@pytest.mark.skipif(not shutil.which("node"), reason="needs node")
def test_an_avatar_is_posed_in_the_axes_of_its_version_of_vrm():
    script = (EXAMPLES / "avatar.js").read_text() + POSED
    command = ["node", "--input-type=module", "-"]
    found = subprocess.run(command, input=script, capture_output=True, text=True, timeout=60, check=True)
    before, old, new, pose = json.loads(found.stdout)
    assert before == []
    assert old == {"hips": [0, 0, 0, 1], "spine": [-0.5, 0.5, 0.5, 0.5]}
    assert new == {"hips": [0, 0, 0, 1], "spine": [0.5, 0.5, -0.5, 0.5]}
    assert pose == [0, 0, 0, 1, 0.5, 0.5, -0.5, 0.5, 1, 0, 0, 0]


@pytest.mark.skipif(not shutil.which("node"), reason="needs node")
def test_an_avatar_says_a_long_answer_in_messages_that_the_source_takes():
    script = (EXAMPLES / "avatar.js").read_text() + LONG_SPEECH
    command = ["node", "--input-type=module", "-"]
    found = subprocess.run(command, input=script, capture_output=True, text=True, timeout=60, check=True)
    sizes = json.loads(found.stdout)
    assert max(sizes) <= 2**20 and sum(sizes) == 2 * 600000


@pytest.mark.skipif(not shutil.which("node"), reason="needs node")
def test_an_avatar_keeps_what_it_says_before_it_is_connected():
    script = (EXAMPLES / "avatar.js").read_text() + REUSED
    command = ["node", "--input-type=module", "-"]
    found = subprocess.run(command, input=script, capture_output=True, text=True, timeout=60, check=True)
    assert json.loads(found.stdout) == [[1, 1], [2, 2]]


@pytest.mark.skipif(not shutil.which("node"), reason="needs node")
def test_an_avatar_keeps_what_it_says_while_another_page_is_heard():
    """The sockets are the source, the sink, and the source twice more."""
    script = (EXAMPLES / "avatar.js").read_text() + TWO_SENDERS
    command = ["node", "--input-type=module", "-"]
    found = subprocess.run(command, input=script, capture_output=True, text=True, timeout=60, check=True)
    assert json.loads(found.stdout) == [["before", "refused"], [], ["before", "refused"], []]


def test_an_agent_of_pipecat_answers_and_is_interrupted(debug_model, monkeypatch):
    recipe = example("pipecat_agent", "pipecat", monkeypatch)
    frames_pb2 = importlib.import_module("pipecat.frames.protobufs.frames_pb2")
    connect = importlib.import_module("websockets.asyncio.client").connect
    stream = Watched(debug_model.stream(look_ahead=4))
    question, objection = pcm("Do you have time for a question?", USER), pcm("Wait, please.", USER)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]

    async def talk():
        agent = asyncio.create_task(recipe.serve(stream, port))
        heard, frames, others = [], [], []
        while True:
            try:
                user = await connect(f"ws://127.0.0.1:{port}")
                break
            except OSError:
                await asyncio.sleep(0.05)

        async def speak():
            """Ask, object 1.5 s after the answer has begun, and leave 3 s later."""
            start, voice, told = time.monotonic(), question, 0.0
            for first in itertools.count(0, PIECE):
                await asyncio.sleep(start + first / SAMPLE_RATE - time.monotonic())
                if heard and not told and time.monotonic() > heard[0] + 1.5:
                    voice, told = objection, time.monotonic()
                if told and time.monotonic() > told + 3:
                    break
                spoken, voice = voice[:PIECE], voice[PIECE:]
                message = frames_pb2.Frame()
                message.audio.audio = np.append(spoken, np.zeros(PIECE - len(spoken), "<i2")).tobytes()
                message.audio.sample_rate, message.audio.num_channels = SAMPLE_RATE, 1
                await user.send(message.SerializeToString())
            await user.close()

        speaking = asyncio.create_task(speak())
        async for data in user:
            message = frames_pb2.Frame.FromString(data)
            if message.WhichOneof("frame") == "audio":
                heard.append(time.monotonic())
            elif message.WhichOneof("frame") == "interruption":
                others.append(time.monotonic())
            elif "first" in (text := json.loads(message.message.data)):
                frames.append((text["first"], time.monotonic(), text["frames"]))
        await speaking
        agent.cancel()
        await asyncio.gather(agent, return_exceptions=True)
        return np.array(heard), frames, others

    heard, frames, interruptions = asyncio.run(talk())
    numbers, times, poses = zip(*frames, strict=True)
    assert numbers == tuple(range(numbers[0], numbers[0] + len(frames)))
    assert all(len(pose) == 1 and len(pose[0]) == 3 * stream.skeleton.num_bones for pose in poses)
    assert stream.told == ["listen", "clear", "auto", "listen", "clear", "auto"]
    assert stream.has_heard_other
    (begin, end), *_ = runs(heard)
    assert begin + 1 < interruptions[-1] and abs(end - interruptions[-1]) < IN_STEP
    assert abs(times[numbers.index(stream.onsets()[0])] - begin) < IN_STEP


def test_what_fails_while_livekit_draws_reaches_the_runner(debug_model, monkeypatch):
    recipe = example("livekit_agent", "livekit.agents", monkeypatch)

    class Broken(recipe.Avatar):
        def _draw(self, directions):
            raise RuntimeError("no picture")

    async def draw():
        async with asyncio.timeout(10):
            async for _ in Broken(debug_model.stream(look_ahead=0)):
                pass

    with pytest.raises(RuntimeError, match="no picture"):
        asyncio.run(draw())


def test_an_agent_of_livekit_is_drawn_in_step_and_interrupted(debug_model, monkeypatch):
    recipe = example("livekit_agent", "livekit.agents", monkeypatch)
    agents, rtc = importlib.import_module("livekit.agents"), importlib.import_module("livekit.rtc")
    stream = Watched(debug_model.stream(look_ahead=4))
    answer = np.repeat(pcm("That is a good question, and there are two answers to it.", AGENT), 3)[::2]  # 24 kHz

    class Room:
        """A room whose tracks nobody else sees; a `livekit.rtc.Room` needs a server."""

        published = ()

        def isconnected(self):
            return True

        def on(self, *_):
            return None

        off = on

        @property
        def local_participant(self):
            return self

        async def publish_track(self, track, _):
            self.published += (track.kind,)
            return self

        async def wait_for_subscription(self):
            return None

    async def sound():
        for piece in np.array_split(answer, 20):
            yield rtc.AudioFrame(piece.tobytes(), LIVEKIT_RATE, 1, len(piece))

    class Microphone(recipe.AudioInput):
        voice, is_on = pcm("Wait, please, I see what you mean.", USER), False
        next_time = 0.0

        async def __anext__(self):
            self.next_time = (self.next_time or time.monotonic()) + 0.02
            await asyncio.sleep(self.next_time - time.monotonic())
            piece = np.zeros(PIECE, "<i2")
            if self.is_on:
                spoken, self.voice = np.split(self.voice, [PIECE])
                piece[: len(spoken)] = spoken
            return rtc.AudioFrame(piece.tobytes(), SAMPLE_RATE, 1, len(piece))

    async def talk():
        session, room, pushed, played = agents.AgentSession(), Room(), [], []
        avatar, runner = await recipe.start_avatar(session, room, stream)
        push = runner.av_sync.push

        async def note(frame):
            pushed.append((time.monotonic(), frame))
            await push(frame)

        runner.av_sync.push = note
        session.output.audio.on("playback_finished", played.append)
        await session.start(agents.Agent(instructions=""))
        microphone = Microphone(label="microphone")
        session.input.audio = recipe.UserAudio(microphone, avatar.body)
        await session.say("whole", audio=sound()).wait_for_playout()
        await asyncio.sleep(0.5)
        speech = session.say("interrupted", audio=sound())
        await asyncio.sleep(1)
        microphone.is_on = True  # which LiveKit hears
        await speech.wait_for_playout()
        interrupted = time.monotonic()
        await asyncio.sleep(0.5)
        await session.aclose()
        await runner.aclose()
        return room, pushed, played, interrupted

    room, pushed, played, interrupted = asyncio.run(talk())
    assert len(room.published) == 2
    assert [event.interrupted for event in played] == [False, True]
    assert played[0].playback_position == pytest.approx(len(answer) / LIVEKIT_RATE, abs=0.01)
    assert 0.5 < played[1].playback_position < 1.5
    sounds = np.array([at for at, frame in pushed if isinstance(frame, rtc.AudioFrame)])
    pictures = [(at, bytes(frame.data)) for at, frame in pushed if isinstance(frame, rtc.VideoFrame)]
    assert sounds.max() < interrupted + 0.1
    assert np.median(np.diff([at for at, _ in pictures])) < IN_STEP
    assert len({data for _, data in pictures}) > 10
    assert abs(pictures[stream.onsets()[0]][0] - sounds[0]) < IN_STEP
    assert [told for told in stream.told if told != "auto"] == ["listen", "clear"] and stream.has_heard_other
