"""Frames between those of the model come as soon as they can, leave at their times, and are dropped where very late."""

import threading

import numpy as np
import pytest
from apps.live.standins import FPS, poses

from ha2g_jax.apps.live.clock import StopFlag
from ha2g_jax.apps.live.frames import Frame, Interpolation
from ha2g_jax.apps.live.sender import HELD_SECONDS, TOO_LATE, Meter, Sender
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import load_skeleton, normalize

SKELETON = load_skeleton("ted_expressive")


class Receiver:
    """A sink that notes when it takes which frame; `slow` seconds pass while it takes one."""

    name, rig = "udp://127.0.0.1:9", "ha2g"

    def __init__(self, clock, slow=0.0, fault=None):
        self.clock, self.slow, self.fault, self.taken = clock, slow, fault, []

    def send(self, frame):
        self.taken.append((frame.number, self.clock.now()))
        self.clock.time += self.slow
        if self.fault:
            raise self.fault


def send(clock, frames, *sinks, delay: float | None = 0.2, stop=None):
    meter = Meter(0.2)
    sender = Sender(sinks, FPS, delay, 1 / FPS, clock, meter)
    for number, heard in frames:
        sender.put(Frame(number, number / FPS, heard, SKELETON, SKELETON.mean_directions, {}), stop or StopFlag())
    sender.finish(stop or StopFlag())
    return meter


def in_time(count):
    return [(k, 100 + k / FPS) for k in range(count)]


@pytest.mark.parametrize("delay", [0.2, 3.0])
def test_frames_leave_at_their_times(clock, delay):
    sink = Receiver(clock)
    meter = send(clock, in_time(30), sink, delay=delay)
    assert [number for number, _ in sink.taken] == list(range(30))
    np.testing.assert_allclose([time for _, time in sink.taken], [100 + k / FPS + delay for k in range(30)])
    assert (meter.sent, meter.late, meter.dropped) == (30, 0, 0)
    assert meter.latency(0.5) == meter.latency(0.95) == pytest.approx(delay)


def test_without_times_frames_leave_at_once(clock):
    sink = Receiver(clock)
    assert send(clock, in_time(30), sink, delay=None).sent == 30
    assert {time for _, time in sink.taken} == {100}


def test_frames_more_than_a_hop_late_are_counted_and_those_more_than_a_second_dropped(clock):
    clock.time = 100.2 + 1.5
    meter = send(clock, in_time(30), sink := Receiver(clock))
    sent = [number for number, _ in sink.taken]
    assert sent == list(range(30 - len(sent), 30))
    assert meter.dropped == 30 - len(sent) == sum(1.5 - k / FPS > TOO_LATE for k in range(30))
    assert meter.late == sum(1 / FPS < 1.5 - k / FPS <= TOO_LATE for k in range(30))


def test_a_sink_that_takes_too_long_does_not_make_frames_wait_for_ever(clock):
    meter = send(clock, in_time(90), sink := Receiver(clock, slow=0.5))
    assert meter.sent + meter.dropped == 90
    assert meter.dropped > 60
    assert all(time - (100.2 + number / FPS) <= TOO_LATE + 1e-9 for number, time in sink.taken)


def test_the_computation_waits_while_too_many_frames_wait(clock):
    """The clock stands still, so that no frame is sent."""
    clock.sleep = lambda seconds: None
    sender, count, stop = Sender([Receiver(clock)], FPS, 0.2, 0.1, clock, Meter(0.2)), 0, StopFlag()

    def put():
        nonlocal count
        while not stop.is_asked():
            sender.put(Frame(count, count / FPS, 200, SKELETON, SKELETON.mean_directions, {}), stop)
            count += 1

    thread = threading.Thread(target=put)
    thread.start()
    thread.join(0.3)
    assert thread.is_alive()
    assert count <= HELD_SECONDS * FPS + 1  # and the one that the thread holds
    stop.ask()
    thread.join()
    sender.finish(stop)


def test_a_network_that_is_down_is_reported_once_and_the_others_go_on(clock, capsys):
    sink = Receiver(clock)
    meter = send(clock, in_time(5), Receiver(clock, fault=OSError(101, "Network is unreachable")), sink)
    assert len(sink.taken) == meter.sent == 5
    assert capsys.readouterr().err == "udp://127.0.0.1:9 misses frames: network is unreachable\n"


@pytest.mark.parametrize("delay", [None, 0.2])
def test_frames_that_no_sink_takes_are_dropped(clock, delay):
    meter = send(clock, in_time(5), Receiver(clock, fault=OSError(101, "Network is unreachable")), delay=delay)
    assert (meter.sent, meter.late, meter.dropped, meter.latency(0.5)) == (0, 0, 5, None)


def test_frames_that_wait_are_left_out_when_the_run_is_to_stop(clock):
    stop = StopFlag()
    clock.sleep = lambda seconds: stop.ask()
    sink = Receiver(clock)
    send(clock, [(0, 500)], sink, stop=stop)
    assert sink.taken == []


def test_quantiles_of_the_latency_are_those_of_numpy():
    meter, latencies = Meter(0.2), np.random.default_rng(0).gamma(3, 0.1, 1000)
    for latency in latencies:
        meter.count_latency(latency)
    for quantile in (0.5, 0.95):
        assert meter.latency(quantile) == pytest.approx(np.quantile(latencies, quantile), abs=0.005)
    assert Meter(0.2).latency(0.5) is None


def interpolated(frames, target, cuts=()):
    interpolation = Interpolation(FPS, target)
    parts = [interpolation.add(part) for part in np.split(frames, list(cuts))]
    return np.concatenate([*parts, interpolation.end()])


@pytest.mark.parametrize("target", [15, 24, 30, 60])
def test_each_frame_lies_between_its_two_neighbours_in_time(skeleton, target):
    frames = poses(skeleton, 20)
    found = interpolated(frames, target)
    assert found.dtype == np.float32 and len(found) == round(20 * target / FPS)
    for number, pose in enumerate(found):
        time = min(number * FPS / target, 19)
        before, after = frames[int(time)], frames[min(int(time) + 1, 19)]
        np.testing.assert_allclose(pose, normalize(before + (time % 1) * (after - before)), atol=1e-6)


@pytest.mark.parametrize("target", [24, 60])
def test_how_frames_arrive_does_not_matter(skeleton, target):
    frames = poses(skeleton, 20)
    for cuts in ([0, 1, 1, 5, 19], range(20)):
        np.testing.assert_array_equal(interpolated(frames, target, cuts), interpolated(frames, target))


@pytest.mark.parametrize("target", [15, 24, 30, 50, 60])
def test_no_frame_waits_longer_than_stated(skeleton, target):
    interpolation, number, waits = Interpolation(FPS, target), 0, []
    for taken, pose in enumerate(poses(skeleton, 40)):
        for _ in interpolation.add(pose[None]):
            waits.append(taken / FPS - number / target)
            number += 1
    assert min(waits) >= 0
    assert max(waits) == pytest.approx(interpolation.delay)


@pytest.mark.parametrize("target", [0, 14, 121])
def test_other_rates_are_refused(target):
    with pytest.raises(UserError, match="expected 15, the rate of the model, to 120"):
        Interpolation(FPS, target)
