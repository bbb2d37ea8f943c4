"""A stream at the pace of the clock hears each voice in time, and shows each frame once, in order, at its time."""

import asyncio
import contextlib
import time
from typing import Any

import numpy as np
import pytest

from ha2g_jax.apps.live.paced import PacedStream
from ha2g_jax.errors import UserError

FPS, DELAY, RATE = 50, 3, 16000  # frames of the stream that stands in, of its latency; samples per second
SOUND = np.arange(1, 4001, dtype="<i2")  # a quarter of a second


class Standin:
    """A stream whose frames hold their numbers, and which keeps what it heard."""

    fps, latency, state = FPS, DELAY / FPS, "auto"

    def __init__(self):
        self.own, self.other = np.zeros((2, 0), np.float32)
        self.num_returned, self.cleared = 0, []

    def feed(self, own, other):
        self.own, self.other = np.append(self.own, own), np.append(self.other, other)
        first, self.num_returned = self.num_returned, max(len(self.own) * FPS // RATE - DELAY + 1, 0)
        return np.arange(first, self.num_returned)

    def clear(self):
        self.own[self.num_returned * RATE // FPS :] = 0
        self.cleared.append(self.num_returned)


def run(script, seconds=0.5, stream: Any = None):
    """The stream, and the numbers and times of the frames shown, after a script that is told when a frame is shown."""
    stream = stream or Standin()
    shown = []

    async def main():
        clock = asyncio.get_running_loop().time
        start = clock()

        async def show(number, frame):
            assert frame == number
            shown.append((number, clock() - start))
            script(paced, number)

        paced = PacedStream(stream, show)
        script(paced, -1)
        try:
            async with asyncio.timeout(seconds):
                await paced.run()
        except TimeoutError:
            return

    asyncio.run(main())
    assert [number for number, _ in shown] == list(range(len(shown)))
    assert all(time >= (number + DELAY) / FPS for number, time in shown)
    return stream, shown


@pytest.mark.parametrize("pieces", [1, 7])
def test_sound_that_comes_at_once_is_heard_as_it_is_played(pieces):
    begun = []

    def script(paced, number):
        if number == 5:
            for piece in np.array_split(SOUND, pieces):
                begun.append(paced.say(piece.tobytes(), RATE))
        if number == 6:
            paced.hear(SOUND[:3200].tobytes(), RATE)

    stream, _ = run(script)
    assert len(set(begun)) == 1  # the later pieces go on with the sound before them
    start = round(begun[0] * RATE)
    assert start * FPS == (5 + DELAY) * RATE  # frame 5 was shown when so much had been heard
    np.testing.assert_array_equal(stream.own[start:][: len(SOUND)], SOUND / np.float32(32768))
    assert not stream.own[:start].any() and not stream.own[start + len(SOUND) :].any()
    np.testing.assert_array_equal(stream.other[start + RATE // FPS :][:3200], SOUND[:3200] / np.float32(32768))


def test_of_what_the_other_said_during_a_stall_the_end_is_heard():
    def script(paced, number):
        for piece in np.array_split(np.tile(SOUND, 2), 20) if number == 3 else ():
            paced.hear(piece.tobytes(), RATE)

    stream, _ = run(script)
    heard = stream.other[stream.other != 0]
    assert 3200 <= len(heard) <= 3200 + 400 and heard[-1] == SOUND[-1] / 32768  # the last piece is whole


def test_long_pieces_of_the_other_are_heard_whole():
    stream, _ = run(lambda paced, number: number in (3, 15) and paced.hear(SOUND.tobytes(), RATE), seconds=0.8)
    np.testing.assert_array_equal(stream.other[stream.other != 0], np.tile(SOUND, 2) / np.float32(32768))


def test_a_second_run_goes_on_where_the_first_ended():
    stream: Any = Standin()
    shown = []

    async def show(number, frame):
        assert frame == number
        shown.append(number)

    async def main():
        paced = PacedStream(stream, show)
        for _ in range(2):
            paced.say(SOUND[:1600].tobytes(), RATE)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.3):
                    await paced.run()

    asyncio.run(main())
    assert shown == list(range(len(shown))) and len(stream.own) * FPS // RATE - len(shown) - DELAY + 1 in (0, 1)
    np.testing.assert_array_equal(stream.own[stream.own != 0], np.tile(SOUND[:1600], 2) / np.float32(32768))


def test_runs_that_are_cancelled_while_they_compute_leave_the_frames_in_time():
    class Slow(Standin):
        num_feeds, num_at_work, most_at_work = 0, 0, 0

        def feed(self, own, other):
            self.num_feeds += 1
            self.num_at_work += 1
            self.most_at_work = max(self.most_at_work, self.num_at_work)
            time.sleep(1.5 / FPS)
            self.num_at_work -= 1
            return super().feed(own, other)

    stream: Any = Slow()
    shown = []

    async def show(number, frame):
        shown.append(number)

    async def main():
        paced = PacedStream(stream, show)
        for number in range(8):
            task = asyncio.create_task(paced.run())
            while stream.num_feeds <= number:
                await asyncio.sleep(0.001)
            task.cancel()
            if number % 2:  # cancelled again while it waits for the computation
                await asyncio.sleep(0.001)
                task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.3):
                await paced.run()

    asyncio.run(main())
    assert stream.most_at_work == 1
    assert shown == list(range(len(shown))) and len(stream.own) * FPS // RATE - len(shown) - DELAY + 1 in (0, 1)


def test_sound_of_another_rate_has_its_length():
    stream, _ = run(lambda paced, number: number == 3 and paced.say(np.tile(SOUND, 2).tobytes(), 2 * RATE))
    assert abs(np.count_nonzero(stream.own) - len(SOUND)) < 0.001 * RATE


def test_pieces_of_another_rate_are_those_of_one_while_sound_waits():
    pieces = (2000 * np.sin(np.arange(24000) / 7)).astype("<i2").reshape(4, -1)

    def heard(*parts):
        def script(paced, number):
            for part in parts[number // 4 : number // 4 + 1] if number % 4 == 0 else ():
                paced.say(part.tobytes(), 24000)

        return run(script, 1.4)[0].own

    whole, cut = (sound[np.flatnonzero(sound)[0] :][:15000] for sound in (heard(pieces.ravel()), heard(*pieces)))
    np.testing.assert_allclose(cut, whole, atol=1e-6)


def test_a_piece_may_end_within_a_sample():
    def script(paced, number):
        if number == 3:
            paced.say(b"x", 2 * RATE)  # cut off, before sound of another rate
            for piece in (SOUND.tobytes()[:333], SOUND.tobytes()[333:]):
                paced.say(piece, RATE)
            with pytest.raises(UserError, match="0 samples a second"):
                paced.hear(SOUND.tobytes(), 0)
            with pytest.raises(UserError, match="the sound is ndarray; expected bytes"):
                paced.say(SOUND, RATE)

    stream, _ = run(script)
    np.testing.assert_array_equal(stream.own[stream.own != 0], SOUND / np.float32(32768))


def test_after_clear_the_agent_is_silent_from_the_next_frame_on():
    def script(paced, number):
        if number == -1:
            paced.say(np.tile(SOUND, 4).tobytes(), RATE)
        if number == 9:
            paced.clear()
            paced.change(state="listen")

    stream, shown = run(script)
    assert stream.cleared == [10] and stream.state == "listen"
    assert stream.own[: 10 * RATE // FPS].all() and not stream.own[10 * RATE // FPS :].any()
    assert len(stream.own) * FPS // RATE - len(shown) - DELAY + 1 in (0, 1)  # as much as time has passed


def test_a_change_or_cue_that_cannot_be_used_does_not_end_the_run(caplog):
    class Refusing(Standin):
        def __setattr__(self, name, value):
            if name == "state" and value == "sleep":
                raise UserError("no such state")
            super().__setattr__(name, value)

    def script(paced, number):
        if number == 3:
            with pytest.raises(UserError, match="a stream has no mute; expected state, muted"):
                paced.change(mute=True)
            with pytest.raises(UserError, match="no cue 'wave_hello'"):
                paced.cue("wave_hello")
            paced.change(state="sleep")
            paced.change(state="think")

    stream, shown = run(script, stream=Refusing())
    assert len(shown) > 10 and stream.state == "think"
    assert "no such state" in caplog.text
