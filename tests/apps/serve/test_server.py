"""The process: how it begins, what it does when it is full, and how it ends."""

import signal
import socket
import time

import pytest
from fixtures.service import TOKEN, begin, closing, command, finish, running, speech, wav
from websockets.exceptions import InvalidStatus

from ha2g_jax import cli
from ha2g_jax.apps.serve.settings import Settings, check
from ha2g_jax.errors import UserError


def test_a_port_that_is_taken_is_one_line(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert cli.main(["serve", "--port", str(taken.getsockname()[1])]) == 2
    assert "give another --port" in capsys.readouterr().err


BAD_SETTINGS = {
    "host": ({"host": "0.0.0.0"}, "other machines reach 0.0.0.0: give --token"),
    "short token": ({"token": "secret"}, "16 or more random characters"),
    "space": ({"token": TOKEN + " "}, "begins or ends with a space"),
    "no scheme": ({"origins": ("example.org",)}, "'example.org' is not as browsers send it"),
    "path": ({"origins": ("https://example.org/",)}, "give it in the form https://example.org"),
    "capitals": ({"origins": ("https://Example.org",)}, "Example"),
    "port": ({"origins": ("https://example.org:443",)}, "443"),
    "rate": ({"rate": float("nan")}, "--rate is nan"),
}


@pytest.mark.parametrize("name", BAD_SETTINGS)
def test_bad_settings_are_refused(name):
    settings, message = BAD_SETTINGS[name]
    with pytest.raises(UserError, match=message):
        check(Settings(**settings))
    check(Settings(host="0.0.0.0", token=TOKEN, origins=("https://example.org", "http://localhost:3000")))


def test_a_full_service_refuses_and_those_that_run_go_on(debug_model):
    with running(debug_model, sessions=1, requests=0) as client, client.stream() as websocket:
        begin(websocket)
        with pytest.raises(InvalidStatus) as refused, client.stream():
            pass
        assert refused.value.response.status_code == 503 and int(refused.value.response.headers["Retry-After"]) > 0
        full = client.post("", wav(0.3))
        assert full.status == 503 and int(full.headers["Retry-After"]) > 0 and "requests are running" in full.error
        plain = client.ask("GET", "/v1/stream")  # as a page asks, which is not told why its stream was refused
        assert plain.status == 503 and plain.error == "1 streams are running; try again later"
        websocket.send(speech(0.5).tobytes())
        frames, _ = finish(websocket)
        assert len(frames) == 8
        while not client.service.is_idle:
            time.sleep(0.01)
        assert client.ask("GET", "/v1/stream").headers["Upgrade"] == "websocket"
        with client.stream() as another:
            assert begin(another)["fps"] == 15
        metrics = client.ask("GET", "/metrics").body.decode()
    assert 'ha2g_requests_total{route="/v1/stream",status="503"} 2.0' in metrics
    assert 'ha2g_requests_total{route="/v1/stream",status="101"} 2.0' in metrics and "ha2g_frames_total 8.0" in metrics


def test_sigterm_lets_a_request_and_a_stream_finish(debug_folder):
    """In a process of its own: no further connection is taken, what runs is answered, and the exit code is 0."""
    with command(debug_folder) as (process, client):
        form = b'--x\r\nContent-Disposition: form-data; name="speech"; filename="a"\r\n\r\n' + wav(1) + b"\r\n--x--\r\n"
        with client.stream() as websocket, client.begin_upload(form[:1000], len(form)) as upload:
            begin(websocket)
            while "ha2g_requests_running 1.0" not in client.ask("GET", "/metrics").body.decode():
                time.sleep(0.01)
            process.send_signal(signal.SIGTERM)
            with pytest.raises(OSError):
                while True:
                    client.ask("GET", "/health")
                    time.sleep(0.01)
            upload.sendall(form[1000:])
            websocket.send(speech(0.5).tobytes())
            frames, last = finish(websocket)
            assert upload.recv(100).startswith(b"HTTP/1.1 200 ")
        assert len(frames) == last["count"] == 8
        assert process.stderr is not None and process.wait(30) == 0 and process.stderr.read() == ""


def test_a_closed_terminal_ends_it_at_once(debug_folder):
    with command(debug_folder) as (process, client), client.stream() as websocket:
        begin(websocket)
        process.send_signal(signal.SIGHUP)
        _, code = closing(websocket)
        assert code == 1012 and process.stderr is not None
        assert process.wait(10) == 129 and process.stderr.read() == ""


def test_after_the_grace_what_still_runs_is_ended(debug_model):
    with (
        running(debug_model, grace=0.0) as client,
        client.stream() as websocket,
        client.begin_upload(b"", 100) as upload,
    ):
        begin(websocket)
        while not client.service.motions.taken:
            time.sleep(0.01)
        client.server.should_exit = True
        received, code = closing(websocket)
        assert code == 1012 and "has been stopped" in received[-1]["error"]
        assert upload.recv(100).startswith(b"HTTP/1.1 503 ")
