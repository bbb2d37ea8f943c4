"""`ha2g live` from sound to files and receivers: what is recorded, when it ends, and how Ctrl-C ends it."""

import contextlib
import json
import os
import signal
import threading
import time

import numpy as np
import pytest
import soundfile
from apps.live.standins import FPS, FakeStream, poses

from ha2g_jax import cli, synthesis
from ha2g_jax.apps.live import run, sources
from ha2g_jax.apps.live.pieces import Change, Chunk
from ha2g_jax.apps.live.sinks import Sinks, open_sinks
from ha2g_jax.errors import UserError
from ha2g_jax.motion.cues import MOST, Cue
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.windows import DEFAULT_HOP, DEFAULT_LOOK_AHEAD


@pytest.fixture
def live(speaking_model, monkeypatch):
    """A function that runs `ha2g live` with a stand-in for the model."""
    monkeypatch.setattr(synthesis, "load", lambda checkpoint: speaking_model)
    return lambda *arguments: cli.main(["live", *map(str, arguments)])


@pytest.fixture
def speech(tmp_path):
    soundfile.write(tmp_path / "speech.wav", np.random.default_rng(0).normal(0, 0.1, 33075), 44100)  # 0.75 s
    return tmp_path / "speech.wav"


def test_a_recording_has_all_frames_and_says_how_they_were_made(live, speech, tmp_path, skeleton, capsys):
    out = tmp_path / "new" / "motion.npz"
    assert live("--source", speech, "--fast", "--sink", out, "--json", "--seed", 5, "--energy", 0.5) == 0
    motion = Motion.load(out)
    expected = Motion.from_directions(skeleton, poses(skeleton, 11), FPS)
    np.testing.assert_array_equal(motion.directions, expected.directions)
    wanted = {"speech": "speech.wav", "duration": 0.75, "seed": 5, "look_ahead": DEFAULT_LOOK_AHEAD, "hop": DEFAULT_HOP}
    assert motion.meta.items() >= wanted.items()
    assert motion.meta["controls"] == {"energy": 0.5}
    captured = capsys.readouterr()
    summary = json.loads(captured.out)
    assert (summary["frames"], summary["sound_seconds"], summary["dropped"]) == (11, 0.75, 0)
    assert "listening to speech.wav\n" in captured.err and "ha2g live: 0.8 s heard, 11 frames" in captured.err


def test_in_real_time_frames_arrive_after_the_latency_and_the_motion_is_the_same(live, receiver, speech, tmp_path):
    (bound, port), started = receiver, time.monotonic()
    sinks = ("--sink", f"udp://127.0.0.1:{port}", "--sink", tmp_path / "a.npz")
    assert live("--source", speech, *sinks, "--rig", "unity") == 0
    assert time.monotonic() - started > 0.75
    messages = [json.loads(bound.recv(65_536)) for _ in range(12)]
    assert [message["frame"] for message in messages[1:]] == list(range(11))
    assert live("--source", speech, "--fast", "--sink", tmp_path / "b.npz") == 0
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_cue_too_many_is_one_line_and_the_run_goes_on(debug_model, capsys):
    class Source:
        name, is_timed, lost_seconds = "a test", False, 0.0

        def chunks(self, clock, stop):
            yield from [Chunk(np.zeros(0, np.float32), 0.0, change=Change(cue=Cue("nod", 9.0)))] * (MOST + 1)
            yield Chunk(np.zeros(16000, np.float32), 0.0)

    assert run.run(debug_model, Source(), Sinks((), ())).computed == 15
    assert capsys.readouterr().err.count("64 cues wait to be made; give nod when one of them has begun") == 1


def test_a_source_that_fails_leaves_no_thread(debug_model, free_port):
    class Source:
        name, is_timed, lost_seconds = "a test", False, 0.0

        def chunks(self, clock, stop):
            yield Chunk(np.zeros(16000, np.float32), 0.0)
            raise UserError("the sound is damaged")

    before = {*threading.enumerate()}
    with contextlib.ExitStack() as stack, pytest.raises(UserError, match="damaged"):
        run.run(debug_model, Source(), open_sinks([f"udp://127.0.0.1:{free_port()}"], stack, "ha2g"))
    assert not [it.name for it in {*threading.enumerate()} - before if it.name.endswith("(_run)")]


def test_with_a_delay_a_clear_drops_sound_whose_frames_have_not_been_sent(speaking_model, clock, monkeypatch):
    """Frames are computed at most 0.2 s before they are sent, so that the sound of later ones has not been taken."""
    taken, start = [], clock.now()

    class Source:
        name, is_timed, lost_seconds = "a test", True, 0.0

        def chunks(self, clock, stop):
            for number in range(70):
                clock.time = heard = start + 0.02 * number
                if number == 50:
                    yield Chunk(np.zeros(0, np.float32), heard, change=Change(clear=True))
                yield Chunk(np.zeros(320, np.float32), heard)

    monkeypatch.setattr(run, "Clock", lambda: clock)
    monkeypatch.setattr(FakeStream, "clear", lambda stream: taken.append(stream.heard / 16000), raising=False)
    meter = run.run(speaking_model, Source(), Sinks((), ()), look_ahead=0, hop=1, delay=0.6)
    assert taken == [pytest.approx(1 - (0.6 - 1 / FPS - 0.2), abs=0.02)]
    assert (meter.computed, meter.sound_seconds) == (21, pytest.approx(1.4))


def test_a_recording_ends_where_files_of_motion_do(live, speech, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "MAX_MOTION_SECONDS", 0.4)
    assert live("--source", speech, "--fast", "--sink", tmp_path / "a.npz") == 0
    motion = Motion.load(tmp_path / "a.npz")
    assert (motion.num_frames, motion.meta["duration"]) == (6, 0.4)
    assert capsys.readouterr().err.count("the recording is full at 0.4 s") == 1


def test_falling_behind_drops_frames_that_are_recorded_all_the_same(live, speech, tmp_path, monkeypatch, capsys):
    feed = FakeStream.feed

    def stall(stream, samples, other):
        if not stream.heard:
            time.sleep(1.8)
        return feed(stream, samples, other)

    monkeypatch.setattr(FakeStream, "feed", stall)
    sinks = ("--sink", "udp://127.0.0.1:9", "--sink", tmp_path / "a.npz")
    assert live("--source", speech, *sinks, "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["dropped"] > 0
    assert summary["sent"] + summary["dropped"] == summary["frames"] == Motion.load(tmp_path / "a.npz").num_frames == 11


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_an_interrupted_run_is_recorded_whole(live, tmp_path, monkeypatch, capsys, number, code):
    soundfile.write(tmp_path / "long.wav", np.full(16000 * 60, 0.1), 16000)
    interrupt = threading.Timer(0.6, os.kill, (os.getpid(), number))
    monkeypatch.setattr(sources, "_say_listening", lambda name: interrupt.start())
    sinks = ("--sink", "udp://127.0.0.1:9", "--sink", tmp_path / "a.npz")
    assert live("--source", tmp_path / "long.wav", *sinks) == code
    motion = Motion.load(tmp_path / "a.npz")
    assert motion.num_frames == max(1, round(motion.meta["duration"] * FPS)) < 60 * FPS
    assert ("interrupted" in capsys.readouterr().err) == (code == 130)
    assert signal.getsignal(number) in (signal.default_int_handler, signal.SIG_DFL)


def test_without_sound_nothing_is_recorded(live, tmp_path, monkeypatch, capsys):
    read, write = os.pipe()
    os.close(write)
    with os.fdopen(read) as pipe:
        monkeypatch.setattr("sys.stdin", pipe)
        assert live("--source", "stdin", "--sink", tmp_path / "a.npz") == 2
    assert "no sound from stdin" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--source", "{speech}", "--sink", "udp://127.0.0.1:9", "--delay", "0.1"], "the delay is 0.1 s; give 0.667 s"),
        (["--source", "{speech}", "--sink", "a.npz", "--speaker", "nobody"], "nobody"),
    ],
)
def test_mistakes_end_with_one_line(live, speech, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    arguments = [argument.format(speech=speech) for argument in arguments]
    assert live(*arguments) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "a.npz").exists()
