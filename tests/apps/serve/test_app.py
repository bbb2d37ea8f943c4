"""Files of motion over real sockets: what they are, and what is refused."""

import json
import socket
import time

import pytest
from fixtures.service import running, wav

from ha2g_jax.apps.serve.messages import FORMATS, MotionQuery
from ha2g_jax.motion import formats
from ha2g_jax.motion.control import Controls
from ha2g_jax.synthesis import Style


@pytest.mark.parametrize("suffix", FORMATS)
def test_files_are_those_of_generate(client, debug_model, suffix, tmp_path):
    (tmp_path / "a.wav").write_bytes(wav(1))
    options = {"style": Style(mixture={"ada": 1.0, "ben": 3.0}), "seed": 4, "controls": Controls(energy=0.5)}
    motion = debug_model.generate(tmp_path / "a.wav", **options)
    formats.export(motion, tmp_path / f"out.{suffix}")
    answer = client.post(f"format={suffix}&style=ada:1,ben:3&seed=4&energy=0.5", wav(1))
    assert answer.status == 200 and answer.body == (tmp_path / f"out.{suffix}").read_bytes()


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


def test_a_client_that_leaves_is_no_fault_of_the_service(client, caplog):
    head = b"Content-Length: 100\r\nContent-Type: multipart/form-data; boundary=x\r\n\r\n--x"
    with socket.create_connection(("127.0.0.1", client.port), timeout=20) as plain:
        plain.sendall(b"POST /v1/motion HTTP/1.1\r\nHost: localhost\r\n" + head)
        while not client.service.motions.taken:
            time.sleep(0.01)
    while client.service.motions.taken:
        time.sleep(0.01)
    assert client.ask("GET", "/health").status == 200 and not caplog.records


def test_the_description_of_the_routes(client):
    routes = json.loads(client.ask("GET", "/openapi.json").body)["paths"]
    assert set(routes) == {"/health", "/metrics", "/v1/motion"}
    assert {parameter["name"] for parameter in routes["/v1/motion"]["post"]["parameters"]} == set(
        MotionQuery.model_fields
    )
