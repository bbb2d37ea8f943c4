"""Sound has the times at which it is heard; pauses become silence, and nothing waits without bound."""

import io
import json
import socket
import subprocess
import sys
import threading
import time
import types
from typing import Any, cast

import numpy as np
import pytest
import soundfile
import soxr
from apps.live.standins import joined, pcm, tone
from websockets import ConnectionClosed
from websockets.sync.client import connect

from ha2g_jax.apps.live import sources
from ha2g_jax.apps.live.clock import Clock, StopFlag, Timeline
from ha2g_jax.apps.live.network import read_address
from ha2g_jax.apps.live.pieces import Change
from ha2g_jax.apps.live.sources import FileSource, open_source
from ha2g_jax.errors import UserError
from ha2g_jax.motion.cues import Cue


def take(source, clock, seconds):
    """Return the chunks of the first seconds of a source."""
    stop, chunks = StopFlag(), []
    for chunk in source.chunks(stop) if isinstance(source, sources.Inbox) else source.chunks(clock, stop):
        chunks.append(chunk)
        if sum(len(chunk.samples) for chunk in chunks) >= 16000 * seconds:
            stop.ask()
    return chunks


@pytest.mark.parametrize("is_fast", [False, True])
def test_a_file_is_heard_in_real_time_unless_it_is_fast(tmp_path, clock, is_fast):
    soundfile.write(tmp_path / "a.wav", tone(22050), 22050)
    start, position = clock.now(), 0
    source = FileSource(tmp_path / "a.wav", is_fast)
    for chunk in source.chunks(clock, StopFlag()):
        assert chunk.heard == pytest.approx(start + position / 16000)
        position += len(chunk.samples)
        assert clock.now() == pytest.approx(start if is_fast else start + position / 16000)
    assert position == 16000


def test_a_file_ends_when_the_run_is_to_stop(tmp_path, clock):
    soundfile.write(tmp_path / "a.wav", tone(16000), 16000)
    assert len(take(FileSource(tmp_path / "a.wav", False), clock, 0.1)) == 5


def test_stdin_is_read_to_its_end_with_samples_that_two_reads_share(clock):
    class Pipe(io.BytesIO):
        def read(self, size=-1, /):
            return super().read(min(size or 0, 333))

    source = sources.PipeSource(16000, Pipe(pcm(tone(16000)) + b"x"))
    sound = joined(list(source.chunks(Clock(), StopFlag())))
    np.testing.assert_allclose(sound[:16000], tone(16000), atol=1e-4)


@pytest.mark.parametrize(("place", "value"), [(32, 0), (32, 3), (24, 1)])
def test_a_header_that_cannot_be_is_refused(place, value):
    """Without a size of its samples, with one of half a sample, or with one sample a second."""
    soundfile.write(file := io.BytesIO(), tone(16000), 16000, format="WAV")
    content = bytearray(file.getvalue())
    content[place : place + 4] = value.to_bytes(2, "little") + (
        content[place + 2 : place + 4] if place == 32 else b"\0\0"
    )
    with pytest.raises(UserError, match="is a WAV"):
        list(sources.PipeSource(None, io.BytesIO(bytes(content))).chunks(Clock(), StopFlag()))


def test_stdin_that_cannot_be_read_ends_the_run():
    class Broken(io.BytesIO):
        def read(self, size=-1, /):
            raise OSError(9, "Bad file descriptor")

    with pytest.raises(UserError, match=r"stdin cannot be read \(bad file descriptor\)"):
        list(sources.PipeSource(16000, Broken()).chunks(Clock(), StopFlag()))


@pytest.mark.parametrize(
    ("kind", "rate", "message"),
    [
        ("FLAC", None, "what is sent is FLAC; send WAV or raw PCM"),
        ("MP3", None, "what is sent is MP3; send WAV or raw PCM"),
        ("WAV", 8000, "16000 samples a second, not 8000"),
    ],
)
def test_other_files_and_another_rate_on_stdin_are_refused(kind, rate, message):
    soundfile.write(file := io.BytesIO(), tone(16000), 16000, format=kind)
    with pytest.raises(UserError, match=message):
        list(sources.PipeSource(rate, io.BytesIO(file.getvalue())).chunks(Clock(), StopFlag()))


_WAITING = """
import threading, time
from ha2g_jax.apps.live.sources import Inbox, PipeSource
from ha2g_jax.apps.live.clock import Clock
threading.Thread(target=PipeSource(16000)._read, args=(Inbox(16000, Clock()),), daemon=True).start()
time.sleep(0.2)
"""


def test_a_program_ends_while_stdin_sends_nothing():
    process = subprocess.Popen([sys.executable, "-c", _WAITING], stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.wait(60) == 0 and process.stderr is not None and process.stderr.read() == b""
    process.communicate()


def test_where_nothing_is_sent_silence_is_heard_and_the_clock_goes_on(clock):
    source = sources.Inbox(16000, clock)
    source.put(tone(16000, 0.5))
    chunks = take(source, clock, 1.0)
    assert chunks[0].heard == 100
    assert joined(chunks[:5]).any() and not joined(chunks[5:]).any()
    ends = [chunk.heard + len(chunk.samples) / 16000 for chunk in chunks]
    np.testing.assert_allclose([chunk.heard for chunk in chunks[1:]], ends[:-1])
    assert ends[-1] - 0.03 <= clock.now() <= ends[-1] + 0.03


def test_empty_messages_are_no_sound(clock):
    source = sources.Inbox(16000, clock)
    heard = source.chunks(StopFlag())
    for _ in range(50):
        source.put(np.zeros(0, np.float32))
        assert len(next(heard).samples)


def test_a_pipe_that_does_not_block_is_heard_to_its_end(clock):
    pieces = iter([b"\1\0" * 800, None, b"\1\0" * 800, b""])
    source = sources.PipeSource(16000, cast(Any, types.SimpleNamespace(read=lambda count: next(pieces))))
    assert np.count_nonzero(joined(list(source.chunks(clock, StopFlag())))) == 1600


def test_sound_after_a_pause_is_heard_when_it_arrives(clock):
    source = sources.Inbox(16000, clock)
    heard = source.chunks(StopFlag())
    for _ in range(10):
        next(heard)
    source.put(tone(16000, 0.1))
    clock.time += 0.02
    chunk = next(chunk for chunk in heard if chunk.samples.any())
    assert chunk.heard == pytest.approx(clock.now(), abs=0.021)


def test_sound_that_is_sent_ahead_is_heard_in_its_order(clock):
    source = sources.Inbox(16000, clock)
    for _ in range(3):
        source.put(tone(16000, 0.5))
    chunks = take(source, clock, 1.5)
    np.testing.assert_allclose([chunk.heard for chunk in chunks], 100 + 0.1 * np.arange(15))
    assert 101.35 <= clock.now() <= 101.4  # and not before its time


def test_a_run_that_was_held_up_catches_up(clock):
    """Pieces of a microphone arrive all the while, and are heard when they arrived."""
    source, stop, chunks = sources.Inbox(16000, clock), StopFlag(), []
    sent = resumed = 0
    for chunk in source.chunks(stop):
        chunks.append(chunk)
        if len(chunks) == 20:  # held up for a second
            for _ in range(50):
                clock.time += 0.02
                source.put(tone(16000, 0.02))
                sent += 1
            resumed = clock.now()
        if len(chunks) == 100:
            stop.ask()
    sound = [chunk for chunk in chunks if chunk.samples.any()]
    assert sum(len(chunk.samples) for chunk in sound) == sent * 320
    assert sound[-1].heard < resumed + 0.05


def test_a_sender_waits_while_too_much_sound_waits(monkeypatch):
    monkeypatch.setattr(sources, "_AHEAD_SECONDS", 0.1)
    source = sources.Inbox(16000, Clock())
    count = 0

    def send():
        nonlocal count
        while source.put(np.zeros(10, np.float32)):
            count += 1

    thread = threading.Thread(target=send)
    thread.start()
    thread.join(0.3)
    assert thread.is_alive()
    source.close()
    thread.join()
    assert count == 160


class Device:
    """A stand-in for sounddevice, whose microphone gives `pieces` at once and then nothing."""

    PortAudioError = type("PortAudioError", (Exception,), {})

    def __init__(self, clock, pieces, fault=None):
        self.clock, self.pieces, self.fault, self.is_closed = clock, pieces, fault, False

    def query_devices(self, kind):
        if self.fault:
            raise self.PortAudioError(self.fault)
        return {"default_samplerate": 16000.0}

    def InputStream(self, *, samplerate, channels, dtype, blocksize, callback):
        self.callback, self.size = callback, blocksize
        return self

    def start(self):
        for piece in range(self.pieces):
            self.clock.time += self.size / 16000
            self.callback(np.full((self.size, 1), piece, np.float32), self.size, None, None)

    def close(self):
        self.is_closed = True


def test_a_microphone_does_not_wait_and_counts_what_is_lost(clock, monkeypatch, capsys):
    device = Device(clock, sources._QUEUE + 25)
    monkeypatch.setitem(sys.modules, "sounddevice", device)
    source = sources.MicrophoneSource(None)
    chunks = list(source.chunks(clock, StopFlag()))  # ends, as there is no more sound
    assert source.lost_seconds == pytest.approx(0.5)
    assert len(chunks) == sources._QUEUE
    assert chunks[-1].heard == pytest.approx(100 + 0.02 * (sources._QUEUE - 1))
    assert chunks[-1].samples[0] == sources._QUEUE - 1
    assert device.is_closed
    assert "no sound from microphone" in capsys.readouterr().err


def test_a_microphone_that_is_missing_is_said_in_one_line(clock, monkeypatch):
    monkeypatch.setitem(sys.modules, "sounddevice", Device(clock, 0, "Error querying device -1"))
    with pytest.raises(UserError, match=r"no microphone can be used \(Error querying device -1\)"):
        sources.MicrophoneSource(None)
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(UserError, match=r"the microphone needs sounddevice: pip install 'ha2g-jax\[live\]'"):
        sources.MicrophoneSource(None)


@pytest.fixture
def listening(free_port):
    """The address of a WebSocket source, and the chunks that a thread takes from it."""
    address, stop, chunks = read_address(f"ws://127.0.0.1:{free_port()}"), StopFlag(), []
    source = sources.WebSocketSource(address, 16000)
    thread = threading.Thread(target=lambda: chunks.extend(source.chunks(Clock(), stop)), daemon=True)
    thread.start()
    yield address, chunks
    stop.ask()
    thread.join(10)
    assert not thread.is_alive()


def test_a_websocket_takes_binary_messages_of_one_sender(listening):
    address, chunks = listening
    with connect_when_ready(address) as sender:
        time.sleep(0.5)  # until the thread of this sender has begun
        with connect(str(address)) as other:
            sender.send(pcm(tone(16000))[:1001])
            with pytest.raises(ConnectionClosed, match="another sender"):
                other.recv(timeout=5)
            sender.send(pcm(tone(16000))[1001:])
    end = time.monotonic() + 10
    while sum(np.count_nonzero(chunk.samples) for chunk in chunks) < 15_000 and time.monotonic() < end:
        time.sleep(0.01)
    sound = joined([chunk for chunk in chunks if chunk.samples.any()])  # silence may be heard between the messages
    np.testing.assert_allclose(sound[:16000], tone(16000), atol=1e-4)


def test_a_websocket_source_says_when_it_listens(free_port, clock, monkeypatch):
    address, said = read_address(f"ws://127.0.0.1:{free_port()}"), []

    def reach(name):
        socket.create_connection((address.host, address.port)).close()
        said.append(name)

    monkeypatch.setattr(sources, "_say_listening", reach)
    take(sources.WebSocketSource(address, 16000), clock, 0.1)
    assert said == [str(address)]


def test_a_sender_that_vanished_gives_its_place_to_the_next_one(listening, monkeypatch):
    """It has lost its network: nothing answers, and nobody has closed the connection. Its sound does not go on."""
    monkeypatch.setattr(sources, "_ANSWER_SECONDS", 0.2)
    address, chunks = listening
    with connect_when_ready(address) as sender:
        sender.send(pcm(tone(160_000)))
        wait_for(lambda: any(chunk.samples.any() for chunk in chunks))
        monkeypatch.setattr(sender.protocol, "receive_data", lambda data: None)
        with connect(str(address)) as other:
            other.send(pcm(-tone(1600)))
            wait_for(lambda: any(chunk.change for chunk in chunks))
            index = next(index for index, chunk in enumerate(chunks) if chunk.change)
            wait_for(lambda: any(chunk.samples.any() for chunk in chunks[index:]))
            time.sleep(0.3)
        heard = sum(np.count_nonzero(chunk.samples) for chunk in chunks[index:])
        assert chunks[index].change.clear and 1000 < heard <= 1600


def test_a_sender_that_is_too_far_ahead_is_told_so(listening, monkeypatch):
    monkeypatch.setattr(sources, "_AHEAD_SECONDS", 2)
    told = pytest.raises(ConnectionClosed, match="2 s of sound wait to be heard; send later sound later")
    with connect_when_ready(listening[0]) as sender, told:
        for _ in range(5):
            sender.send(pcm(tone(16000)))
        sender.recv(timeout=5)


def test_after_a_clear_the_next_wav_is_heard_whole(listening):
    """The rest of the WAV that was interrupted is never sent."""
    address, chunks = listening
    soundfile.write(first := io.BytesIO(), tone(16000, 10), 16000, format="WAV")
    soundfile.write(second := io.BytesIO(), tone(16000, 0.5), 16000, format="WAV")
    with connect_when_ready(address) as sender:
        sender.send(first.getvalue()[:40_000])
        sender.send('{"clear": true}')
        sender.send(second.getvalue())
    wait_for(lambda: any(chunk.change is not None for chunk in chunks))
    start = next(index for index, chunk in enumerate(chunks) if chunk.change is not None)
    wait_for(lambda: sum(np.count_nonzero(chunk.samples) for chunk in chunks[start:]) > 7800)
    heard = joined([chunk for chunk in chunks[start:] if chunk.samples.any()])
    np.testing.assert_allclose(heard[200:7800], tone(16000)[200:7800], atol=0.01)


TEXTS = [
    *("text", "[]", "{}", '{"muted": 1}', '{"muted": true, "energy": 2}', "[" * 100_000, '{"state": "sleep"}'),
    *('{"state": []}', '{"clear": false}', '{"clear": 1}', '{"cue": 3}', '{"cue": "dance"}', '{"cue": "clip:/a"}'),
    *('{"cue": "nod", "word": "yes"}', '{"cue": "nod", "time": -1}', '{"cue": "nod", "time": NaN}'),
]


def test_a_websocket_answers_other_text_and_listens_on(listening):
    scrambled = np.random.default_rng(0).integers(32, 127, (200, 40), np.uint8)
    with connect_when_ready(listening[0]) as sender:
        for text in TEXTS + [bytes(row).decode() for row in scrambled]:
            sender.send(text)
            answer = json.loads(sender.recv(timeout=5))
            assert answer.keys() == {"error"} and "\n" not in answer["error"]
        sender.send('{"state": "sleep"}')
        assert "no state sleep; expected one of: auto" in str(sender.recv(timeout=5))
        sender.send(pcm(tone(1600)))
        wait_for(lambda: any(chunk.samples.any() for chunk in listening[1]))


def test_a_sender_changes_the_stream_from_a_moment_on(listening):
    address, chunks = listening
    texts = '{"muted":true}', '{"state": "listen"}', '{"cue": "count:3", "time": 9}', '{"muted": false}'
    with connect_when_ready(address) as sender:
        for text in texts:
            sender.send(pcm(tone(1600, 0.5)))
            sender.send(text)
    wait_for(lambda: sum(chunk.change is not None for chunk in chunks) == 4)
    told = [chunk.change for chunk in chunks if chunk.change is not None or chunk.samples.any()]
    assert told == [
        *(None, Change(muted=True), None, Change(state="listen")),
        *(None, Change(cue=Cue("count:3", 9)), None, Change(muted=False)),
    ]


@pytest.mark.parametrize("rate", [16000, 24000])
def test_a_clear_drops_the_sound_that_waits(clock, rate):
    source, chunks = sources.Inbox(rate, clock, 2), []
    source.put(np.stack([tone(rate), -tone(rate)], axis=-1))
    for chunk in source.chunks(StopFlag()):
        chunks.append(chunk)
        if len(chunks) == 3:
            source.put(Change(muted=True))
            source.put(Change(clear=True))
        if clock.now() > 101:
            break
    changes = [index for index, chunk in enumerate(chunks) if chunk.change is not None]
    assert [chunks[index].change for index in changes] == [Change(muted=True), Change(clear=True)]
    before, after = chunks[: changes[-1]], chunks[changes[-1] :]
    assert joined(before).any() and not joined(after).any()
    assert clock.now() - 0.05 < 100 + len(joined(chunks)) / 16000 < clock.now() + 0.05
    for chunk in before:
        if chunk.other is not None:
            np.testing.assert_allclose(chunk.other, -chunk.samples, atol=1e-6)


def wait_for(condition):
    """Wait until a condition holds, at most ten seconds."""
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def connect_when_ready(address):
    """Connect to a server that is just starting."""
    for _ in range(200):
        try:
            return connect(str(address))
        except OSError:
            time.sleep(0.02)
    raise TimeoutError(address)


def test_a_timeline_knows_when_a_sample_is_heard_across_a_pause_and_forgets():
    timeline = Timeline(10)
    timeline.add(16000, 100)
    timeline.add(16000, 103)
    assert [timeline.heard(seconds) for seconds in (0, 0.5, 1, 1.5, 2.5)] == [100, 100.5, 103, 103.5, 104.5]
    for piece in range(10_000):
        timeline.add(320, 104 + 0.02 * piece)
    assert len(timeline._pieces) < 600
    assert timeline.heard(201.5) == pytest.approx(303.5)


@pytest.mark.parametrize("rate", [16000, 44100])
def test_a_file_of_two_channels_is_the_agent_and_the_other(tmp_path, rate):
    voices = np.random.default_rng(0).normal(0, 0.1, (2, rate)).astype(np.float32)
    soundfile.write(tmp_path / "both.wav", voices.T, rate, subtype="FLOAT")
    chunks = [*open_source(str(tmp_path / "both.wav"), is_fast=True, channels=2).chunks(Clock(), StopFlag())]
    for voice, found in zip(voices, (joined(chunks), joined(chunks, "other")), strict=True):
        expected = voice if rate == 16000 else soxr.resample(voice, rate, 16000)
        np.testing.assert_allclose(found, expected, atol=1e-4)
    soundfile.write(tmp_path / "loud.wav", 30 * voices.T, rate, subtype="FLOAT")
    loud = [*open_source(str(tmp_path / "loud.wav"), is_fast=True, channels=2).chunks(Clock(), StopFlag())]
    assert np.abs(joined(loud)).max() == np.abs(joined(loud, "other")).max() == 1
    soundfile.write(tmp_path / "one.wav", voices[0], rate)
    with pytest.raises(UserError, match=r"one\.wav has 1 channel; expected 2"):
        open_source(str(tmp_path / "one.wav"), channels=2)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("http://127.0.0.1:80", {}, "no source http"),
        ("stdin", {"rate": 12}, "the rate is 12"),
        ("stdin", {"is_fast": True}, "--fast is for files"),
        ("microphone", {"channels": 2}, "--channels 2 is for sound in which"),
    ],
)
def test_a_source_that_cannot_be_used_is_said_in_one_line(text, options, message):
    with pytest.raises(UserError, match=message) as error:
        open_source(text, **options)
    assert "\n" not in str(error.value)
