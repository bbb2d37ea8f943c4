"""Several workers: connections go to those with the fewest, and one that is killed is replaced."""

import contextlib
import signal
import socket
import time

import numpy as np
import psutil
import pytest
from fixtures.service import begin, command, finish, speech
from websockets.exceptions import ConnectionClosed, InvalidStatus

from ha2g_jax import cli
from ha2g_jax.apps.serve.workers import Child, Report, next_wait


def test_after_a_kill_other_streams_go_on_and_the_worker_is_replaced(debug_model, debug_folder):
    """With one place for a stream in each of two workers, so that two streams are in different workers."""
    limits = ("--workers", "2", "--sessions", "1", "--rate", "0", "--idle-seconds", "600", "--grace", "600")
    pcm = speech(1.5)
    stream = debug_model.stream(seed=3)
    expected = np.concatenate([stream.feed(pcm.astype(np.float32) / 32768), stream.flush()])
    with command(debug_folder, *limits) as (process, client), contextlib.ExitStack() as stack:
        streams = [stack.enter_context(client.stream()) for _ in range(2)]
        for websocket in streams:
            begin(websocket, seed=3)
            websocket.send(pcm[:8000].tobytes())
        with pytest.raises(InvalidStatus) as refused, client.stream():
            pass
        assert refused.value.response.status_code == 503 and int(refused.value.response.headers["Retry-After"]) > 0

        workers = psutil.Process(process.pid).children()
        assert len(workers) == 2
        workers[0].kill()
        assert client.ask("GET", "/health").status == 200
        outcomes = [_rest(websocket, pcm[8000:]) for websocket in streams]
        assert sorted(outcome is None for outcome in outcomes) == [False, True]
        np.testing.assert_allclose(next(o for o in outcomes if o is not None), expected, atol=5.1e-5)

        while workers[0].is_running() or b"ha2g_workers 2.0" not in client.ask("GET", "/metrics").body:
            time.sleep(0.05)
        metrics = client.ask("GET", "/metrics").body.decode()
        assert 'ha2g_requests_total{route="/v1/stream",status="101"} 2.0' in metrics
        streams = [stack.enter_context(_stream_when_free(client)) for _ in range(2)]
        for websocket in streams:
            begin(websocket, seed=3)
        process.send_signal(signal.SIGTERM)
        for websocket in streams:
            websocket.send(pcm.tobytes())
            frames, last = finish(websocket)
            assert len(frames) == last["count"] == len(expected)
        assert process.wait(30) == 0 and process.stderr is not None
        lines = process.stderr.read().splitlines()
        assert len(lines) == 1, lines
        line = lines[0]
        assert "was ended by SIGKILL; another one starts in 1 s" in line


def _stream_when_free(client):
    """Open a stream as soon as it is not refused: a new worker may count as one before it is given connections."""
    while True:
        try:
            return client.stream()
        except InvalidStatus as refused:
            assert refused.response.status_code == 503
            time.sleep(0.05)


def _rest(websocket, pcm):
    """Return the frames (n, bones, 3) of a stream that is sent its last sound, None if its worker was killed."""
    try:
        websocket.send(pcm.tobytes())
        return finish(websocket)[0]
    except ConnectionClosed:
        return None


def test_a_model_that_cannot_be_loaded_ends_the_command(capfd, tmp_path):
    assert cli.main(["serve", "--port", "0", "--workers", "2", "--checkpoint", str(tmp_path / "none")]) == 2
    (line,) = [line for line in capfd.readouterr().err.splitlines() if "so far" not in line]  # without the progress
    assert line.startswith("ha2g: no model in ")


def test_a_worker_that_ends_soon_is_started_ever_more_rarely():
    waits = [0.0]
    for _ in range(7):
        waits.append(next_wait(waits[-1], lasted=2))
    assert waits[1:] == [1, 2, 4, 8, 16, 30, 30] and next_wait(30, lasted=61) == 1


def test_connections_go_to_free_workers_with_the_fewest():
    ours, theirs = socket.socketpair()
    with ours, theirs:
        few, many, full, loading = children = [Child(None, ours, "") for _ in range(4)]
        few.report, many.report, full.report = Report(True, 3, 1), Report(True, 3, 2), Report(True, 3, 0, True)
        assert min(few, many, full, key=lambda child: child.rank) is few
        for _ in range(2):
            assert few.give(theirs)
        assert min(few, many, full, key=lambda child: child.rank) is many
        assert list(few.unreceived) == [theirs, theirs] and not loading.give(theirs)
    assert not any(child.give(theirs) for child in children)
