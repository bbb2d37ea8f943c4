"""The service over real sockets: what it generates, what it refuses, and how it ends."""

import asyncio
import contextlib
import http.client
import io
import json
import os
import pathlib
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import Any, NamedTuple

import numpy as np
import pytest
import soundfile
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import ha2g_jax
from ha2g_jax import cli
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.motion import formats
from ha2g_jax.motion.control import Controls
from ha2g_jax.serve.guard import Rates
from ha2g_jax.serve.messages import FORMATS, MotionQuery
from ha2g_jax.serve.server import Server
from ha2g_jax.serve.service import Service
from ha2g_jax.serve.settings import Settings, check
from ha2g_jax.synthesis import Style

TOKEN = "a-token-of-some-letters"


def speech(seconds: float) -> np.ndarray:
    time = np.arange(round(seconds * SAMPLE_RATE)) / SAMPLE_RATE
    samples = np.random.default_rng(0).normal(0, 0.1, len(time)) * np.sin(4 * np.pi * time) ** 2
    return np.clip(samples * 32768, -32768, 32767).astype("<i2")


def wav(seconds: float) -> bytes:
    file = io.BytesIO()
    soundfile.write(file, speech(seconds), SAMPLE_RATE, format="WAV")
    return file.getvalue()


class Answer(NamedTuple):
    status: int
    body: bytes
    headers: Any

    @property
    def error(self) -> str:
        return json.loads(self.body)["error"]


class Client:
    """A running service and how to reach it."""

    def __init__(self, server: Server, port: int):
        self.server, self.service, self.port = server, server.service, port

    def ask(self, method: str, path: str, body: Any = None, headers: dict[str, str] | None = None) -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        with contextlib.closing(connection):
            connection.request(method, path, body, headers or {})
            response = connection.getresponse()
            return Answer(response.status, response.read(), response.headers)

    def post(self, query: str, content: bytes, name: str = "speech", file: str = "a.wav", **headers: str) -> Answer:
        head = f'--x\r\nContent-Disposition: form-data; name="{name}"; filename="{file}"\r\n\r\n'.encode()
        body = head + content + b"\r\n--x--\r\n"
        kind = {"Content-Type": "multipart/form-data; boundary=x"}
        return self.ask("POST", f"/v1/motion?{query}", body, kind | headers)

    def stream(self, query: str = "", **options: Any) -> Any:
        return connect(f"ws://127.0.0.1:{self.port}/v1/stream{query}", open_timeout=20, max_size=None, **options)


@contextlib.contextmanager
def running(model: Any, **settings: Any):
    service = Service(model, Settings(**({"rate": 0, "grace": 0.0} | settings)))
    server = Server(service)
    with socket.create_server(("127.0.0.1", 0)) as bound:
        thread = threading.Thread(target=asyncio.run, args=(server.serve(sockets=[bound]),))
        thread.start()
        try:
            while thread.is_alive() and not server.started:
                time.sleep(0.01)
            yield Client(server, bound.getsockname()[1])
        finally:
            server.should_exit = True
            thread.join()


@pytest.fixture(scope="module")
def client(debug_model):
    with running(debug_model, max_bytes=100_000, max_seconds=2.5, message_bytes=40_000, idle_seconds=5) as client:
        yield client


@pytest.mark.parametrize("suffix", FORMATS)
def test_files_are_those_of_generate(client, debug_model, suffix, tmp_path):
    (tmp_path / "a.wav").write_bytes(wav(1))
    options = {"style": Style(mixture={"ada": 1.0, "ben": 3.0}), "seed": 4, "controls": Controls(energy=0.5)}
    motion = debug_model.generate(tmp_path / "a.wav", **options)
    formats.export(motion, tmp_path / f"out.{suffix}")
    answer = client.post(f"format={suffix}&style=ada:1,ben:3&seed=4&energy=0.5", wav(1))
    assert answer.status == 200 and answer.body == (tmp_path / f"out.{suffix}").read_bytes()


def test_formats_of_the_query_are_those_of_the_package():
    assert set(MotionQuery.model_json_schema()["properties"]["format"]["enum"]) == set(FORMATS)


BAD_REQUESTS = {
    "format": ("format=exe", None, 422, "format: Input should be"),
    "unknown name": ("formats=npz", None, 422, "Extra inputs"),
    "pin": ("pin=0:1:/etc/passwd", None, 422, "Extra inputs"),
    "seed": ("seed=-1", None, 422, "seed: "),
    "great seed": ("seed=99999999999999999999", None, 422, "seed: "),
    "energy": ("energy=3", None, 422, "the energy is 3.0; expected 0 to 2"),
    "nan": ("energy=nan", None, 422, "the energy is nan"),
    "fps": ("fps=inf", None, 422, "inf frames per second"),
    "speaker": ("speaker=eve", None, 422, "no speaker 'eve' in the model; expected one of: ada, ben"),
    "two styles": ("speaker=ada&style=ben", None, 422, "more than one source"),
    "mixture": ("style=ada,ada", None, 422, "names a speaker twice"),
    "mute": ("mute=2", None, 422, "expected START:END"),
    "late mute": ("mute=20:21", None, 422, "after the end of the motion"),
    "text": ("", b"nothing that sounds", 422, "a.wav"),
    "empty": ("", b"", 422, "empty file"),
    "short": ("", wav(0.1), 422, "a.wav has 0.100 s of sound"),
    "long": ("", wav(2.6), 422, "a.wav has more than"),
    "playlist": ("", b"#EXTM3U\nfile:///etc/passwd\n", 422, "a.wav"),
    "large": ("", bytes(100_001), 413, "more than 100000 bytes"),
}


@pytest.mark.parametrize("name", BAD_REQUESTS)
def test_a_bad_request_is_answered_with_one_line(client, name):
    query, content, status, message = BAD_REQUESTS[name]
    answer = client.post(query, wav(0.3) if content is None else content)
    assert answer.status == status and message in answer.error
    assert "\n" not in answer.error and "/tmp" not in answer.error and len(answer.error) < 1000


BAD_BODIES = {
    "no form": ("POST", b"{}", {"Content-Type": "application/json"}, 422),
    "no body": ("POST", None, {}, 422),
    "no boundary": ("POST", b"x", {"Content-Type": "multipart/form-data"}, 400),
    "broken form": ("POST", b"--x\r\nwhat", {"Content-Type": "multipart/form-data; boundary=x"}, 422),
    "length": ("POST", b"", {"Content-Length": "1e9"}, 400),
    "method": ("GET", None, {}, 405),
}


@pytest.mark.parametrize("name", BAD_BODIES)
def test_a_body_that_is_no_form_is_refused(client, name):
    method, body, headers, status = BAD_BODIES[name]
    answer = client.ask(method, "/v1/motion", body, headers)
    assert answer.status in (status, 400)


def test_a_form_with_another_file_or_two_is_refused(client):
    assert client.post("", wav(0.3), name="sound").status == 422
    two = b'a\r\n--x\r\nContent-Disposition: form-data; name="b"; filename="b"\r\n\r\nb'
    assert client.post("", two).status == 400
    assert client.ask("GET", "/no/such/route").status == 404


def test_bytes_are_counted_while_they_are_read(client):
    """The request does not say how many follow, and is refused before its end."""
    with socket.create_connection(("127.0.0.1", client.port), timeout=20) as plain:
        plain.sendall(
            b"POST /v1/motion HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n"
            b"Content-Type: multipart/form-data; boundary=x\r\n\r\n"
        )
        part = b'--x\r\nContent-Disposition: form-data; name="speech"; filename="a"\r\n\r\n' + bytes(60_000)
        for chunk in (part, bytes(60_000)):
            plain.sendall(f"{len(chunk):x}\r\n".encode() + chunk + b"\r\n")
        assert plain.recv(100).startswith(b"HTTP/1.1 413 ")


def test_a_slow_upload_is_ended(debug_model):
    with running(debug_model, upload_seconds=0.1) as client:
        head = {"Content-Type": "multipart/form-data; boundary=x", "Content-Length": "100"}
        assert client.ask("POST", "/v1/motion", b"--x", head).status == 408


def begin(websocket: Any, **asked: Any) -> dict[str, Any]:
    websocket.send(json.dumps(asked))
    return json.loads(websocket.recv(timeout=20))


def finish(websocket: Any) -> tuple[np.ndarray, dict[str, Any]]:
    """The frames (n, bones, 3) that come after the end is sent, and the last message."""
    websocket.send('{"end": true}')
    rows: list[Any] = []
    while "frames" in (message := json.loads(websocket.recv(timeout=20))):
        assert message["first"] == len(rows)
        rows += message["frames"]
    return np.array(rows).reshape(len(rows), -1, 3), message


def test_a_stream_gives_the_frames_of_the_model(client, debug_model):
    pcm = speech(2.03)
    options = {"look_ahead": 2, "hop": 2, "seed": 5}
    stream = debug_model.stream(**options, style=Style(speaker="ada"))
    expected = np.concatenate([stream.feed(pcm.astype(np.float32) / 32768), stream.flush()])
    with client.stream() as websocket:
        facts = begin(websocket, **options, style={"speaker": "ada"})
        assert facts == {
            "fps": 15,
            "skeleton": "ted_expressive",
            "bones": 42,
            "look_ahead": 2,
            "hop": 2,
            "latency": round(stream.latency, 4),
        }
        for part in np.split(pcm, [3, 9000, 20000]):
            websocket.send(part.tobytes())
        frames, last = finish(websocket)
        assert closing(websocket) == ([], 1000)
    assert last == {"end": True, "count": len(expected)}
    np.testing.assert_allclose(frames, expected, atol=5.1e-5)


def test_another_rate_and_changes_on_the_way(client):
    with client.stream() as websocket:
        begin(websocket, rate=48000, muted=True, controls={"energy": 0.5, "handedness": "left"})
        websocket.send(bytes(24_000))
        websocket.send('{"style": {"mixture": {"ada": 1, "ben": 2}}, "controls": {}, "muted": false}')
        for _ in range(3):
            websocket.send(bytes(24_000))
        frames, last = finish(websocket)
    assert len(frames) == last["count"] == 15


def closing(websocket: Any) -> tuple[list[dict[str, Any]], int]:
    """The messages up to the close of a stream, and its code."""
    received: list[dict[str, Any]] = []
    try:
        while True:
            received.append(json.loads(websocket.recv(timeout=20)))
    except ConnectionClosed as closed:
        assert closed.rcvd is not None
        return received, closed.rcvd.code


BAD_MESSAGES = {
    "binary first": ([b"\0\0"], "the first message is binary"),
    "no JSON": (["what"], "Invalid JSON"),
    "deep JSON": (["[" * 10_000], "JSON"),
    "list": (["[]"], "should be an object"),
    "unknown name": (['{"speed": 1}'], "speed: Extra inputs"),
    "type": (['{"hop": "1"}'], "hop: "),
    "hop": (['{"hop": 0}'], "the hop is 0"),
    "look-ahead": (['{"look_ahead": 99}'], "the look-ahead is 99"),
    "rate": (['{"rate": 1}'], "rate: "),
    "great seed": (['{"seed": 99999999999999999999999}'], "seed"),
    "speaker": (['{"style": {"speaker": "eve"}}'], "no speaker 'eve'"),
    "file": (['{"style": {"images": ["/etc/passwd"]}}'], "style.images: Extra inputs"),
    "half a sample": (["{}", b"\0"], "whole samples of 16 bits"),
    "change": (["{}", '{"controls": {"energy": 9}}'], "the energy is 9"),
    "seed in a change": (["{}", '{"seed": 2}'], "seed: Extra inputs"),
    "no end": (["{}", '{"end": false}'], "end: "),
}


@pytest.mark.parametrize("name", BAD_MESSAGES)
def test_a_bad_message_closes_the_stream_with_one_line(client, name):
    messages, text = BAD_MESSAGES[name]
    with client.stream() as websocket:
        for message in messages:
            websocket.send(message)
        received, code = closing(websocket)
    assert code == 1007
    assert text in received[-1]["error"] and "\n" not in received[-1]["error"]


def test_a_message_that_is_too_large_closes_the_stream(client):
    with client.stream() as websocket:
        begin(websocket)
        websocket.send(bytes(40_002))
        assert closing(websocket) == ([], 1009)


def test_a_full_service_refuses_and_those_that_run_go_on(debug_model):
    with running(debug_model, sessions=1, requests=0) as client, client.stream() as websocket:
        begin(websocket)
        with pytest.raises(InvalidStatus) as refused, client.stream():
            pass
        assert refused.value.response.status_code == 503 and int(refused.value.response.headers["Retry-After"]) > 0
        full = client.post("", wav(0.3))
        assert full.status == 503 and int(full.headers["Retry-After"]) > 0 and "requests are running" in full.error
        websocket.send(speech(0.5).tobytes())
        frames, _ = finish(websocket)
        assert len(frames) == 8
        while not client.service.is_idle:
            time.sleep(0.01)
        with client.stream() as another:
            assert begin(another)["fps"] == 15
        metrics = client.ask("GET", "/metrics").body.decode()
    assert 'ha2g_requests_total{route="/v1/stream",status="503"} 1.0' in metrics
    assert 'ha2g_requests_total{route="/v1/stream",status="101"} 2.0' in metrics and "ha2g_frames_total 8.0" in metrics


@pytest.mark.parametrize(("limit", "text"), [("idle_seconds", "no message for"), ("session_seconds", "has lasted")])
def test_a_stream_that_takes_too_long_is_ended(debug_model, limit, text):
    with running(debug_model, **{limit: 0.3}) as client, client.stream() as websocket:
        websocket.send("{}")
        received, code = closing(websocket)
    assert code == 1008 and text in received[-1]["error"]


def test_every_route_but_health_needs_the_token(debug_model):
    with running(debug_model, token=TOKEN) as client:
        assert client.ask("GET", "/health").status == 200
        right, wrong = {"Authorization": f"Bearer {TOKEN}"}, {"Authorization": f"Bearer {TOKEN}x"}
        for path in ("/metrics", "/openapi.json", "/none"):
            assert client.ask("GET", path).status == 401 and client.ask("GET", path, None, wrong).status == 401
        assert client.ask("GET", "/metrics", None, right).status == 200
        assert client.ask("GET", f"/metrics?token={TOKEN}").status == 401
        assert client.post("", wav(0.3)).status == 401 and client.post("", wav(0.3), **right).status == 200
        for query in ("", "?token=x"):
            with pytest.raises(InvalidStatus) as refused, client.stream(query):
                pass
            assert refused.value.response.status_code == 401
        for query, headers in ((f"?token={TOKEN}", {}), ("", right)):
            with client.stream(query, additional_headers=headers) as websocket:
                assert begin(websocket)["fps"] == 15


def test_pages_of_other_hosts_are_refused(debug_model):
    with running(debug_model, origins=("https://good.example",)) as client:
        with pytest.raises(InvalidStatus) as refused, client.stream(origin="https://evil.example"):
            pass
        assert refused.value.response.status_code == 403
        for origin in ("https://good.example", f"http://127.0.0.1:{client.port}"):
            with client.stream(origin=origin) as websocket:
                assert begin(websocket)["fps"] == 15
        assert client.post("", wav(0.3), Origin="null").status == 403
        assert client.ask("GET", "/metrics", None, {"Host": "evil.example"}).status == 403


def test_the_description_of_the_routes(client):
    routes = json.loads(client.ask("GET", "/openapi.json").body)["paths"]
    assert set(routes) == {"/health", "/metrics", "/v1/motion"}
    assert {parameter["name"] for parameter in routes["/v1/motion"]["post"]["parameters"]} == set(
        MotionQuery.model_fields
    )


def test_each_address_has_its_rate():
    now = 0.0
    rates = Rates(60, lambda: now)
    assert [rates.wait("a") for _ in range(61)] == [0.0] * 60 + [1.0] and rates.wait("b") == 0
    now = 1.0
    assert rates.wait("a") == 0 and rates.wait("a") == 1


def test_too_many_requests_are_told_when_to_come_back(debug_model):
    with running(debug_model, rate=1) as client:
        assert client.ask("GET", "/metrics").status == 200
        answer = client.ask("GET", "/metrics")
        assert answer.status == 429 and 50 < int(answer.headers["Retry-After"]) <= 60
        assert client.ask("GET", "/health").status == 200


BAD_SETTINGS = {
    "host": ({"host": "0.0.0.0"}, "other machines reach 0.0.0.0: give --token"),
    "empty host": ({"host": ""}, "give --token"),
    "short token": ({"token": "secret"}, "16 letters"),
    "port": ({"port": 70000}, "the port is 70000"),
    "rate": ({"rate": float("nan")}, "--rate is nan"),
    "grace": ({"grace": -1}, "--grace is -1"),
    "seconds": ({"max_seconds": 0}, "--max-seconds is 0"),
}


@pytest.mark.parametrize("name", BAD_SETTINGS)
def test_bad_settings_are_refused(name):
    settings, message = BAD_SETTINGS[name]
    with pytest.raises(UserError, match=message):
        check(Settings(**settings))
    check(Settings(host="0.0.0.0", token=TOKEN))


def test_a_missing_extra_is_one_line(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert cli.main(["serve"]) == 2
    assert capsys.readouterr().err == "ha2g: ha2g serve needs uvicorn: pip install 'ha2g-jax[serve]'\n"


def test_a_port_that_is_taken_is_one_line(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert cli.main(["serve", "--port", str(taken.getsockname()[1])]) == 2
    assert "give another --port" in capsys.readouterr().err


def test_sigterm_lets_a_request_and_a_stream_finish(debug_model, tmp_path):
    """In a process of its own: no further connection is taken, what runs is answered, and the exit code is 0."""
    model = model_folder.save(tmp_path / "m", debug_model.config, debug_model.assets, debug_model.variables)
    command = [sys.executable, "-m", "ha2g_jax.cli", "serve", "--port", "0", "--checkpoint", str(model)]
    environment = {**os.environ, "PYTHONPATH": str(pathlib.Path(ha2g_jax.__file__).parents[1])}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stderr is not None
            port = int(next(line for line in process.stderr if "ready at" in line).rsplit(":", 1)[1])
            client = Client(Server(Service(debug_model, Settings())), port)
            form = (
                b'--x\r\nContent-Disposition: form-data; name="speech"; filename="a"\r\n\r\n'
                + wav(1)
                + b"\r\n--x--\r\n"
            )
            head = f"Content-Length: {len(form)}\r\nContent-Type: multipart/form-data; boundary=x\r\n\r\n"
            with client.stream() as websocket, socket.create_connection(("127.0.0.1", port), timeout=20) as upload:
                begin(websocket)
                upload.sendall(f"POST /v1/motion HTTP/1.1\r\nHost: localhost\r\n{head}".encode() + form[:1000])
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
            assert process.wait(30) == 0 and process.stderr.read() == ""
        finally:
            process.kill()


def test_after_the_grace_what_still_runs_is_ended(debug_model):
    with running(debug_model, grace=0.0) as client, contextlib.ExitStack() as stack:
        websocket = stack.enter_context(client.stream())
        begin(websocket)
        upload = stack.enter_context(socket.create_connection(("127.0.0.1", client.port), timeout=20))
        head = "Content-Length: 100\r\nContent-Type: multipart/form-data; boundary=x\r\n\r\n"
        upload.sendall(f"POST /v1/motion HTTP/1.1\r\nHost: localhost\r\n{head}".encode())
        while not client.service.motions.taken:
            time.sleep(0.01)
        client.server.should_exit = True
        received, code = closing(websocket)
        assert code == 1012 and "has been stopped" in received[-1]["error"]
        assert upload.recv(100).startswith(b"HTTP/1.1 503 ")


def test_a_sound_is_read_up_to_its_limit_only(tmp_path):
    (tmp_path / "a.wav").write_bytes(wav(1))
    assert len(read_audio(tmp_path / "a.wav", max_seconds=1)) == SAMPLE_RATE
    with pytest.raises(UserError, match=r"more than 0\.015 minutes"):
        read_audio(tmp_path / "a.wav", max_seconds=0.9)
