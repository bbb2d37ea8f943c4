"""HTTP over real sockets: files of motion, the page, and who may use the service, how often."""

import base64
import errno
import hashlib
import json
import re
import socket
import time

import numpy as np
import pytest
from fixtures.pages import Page
from fixtures.service import TOKEN, begin, running, wav
from websockets.exceptions import InvalidStatus

from ha2g_jax.apps.serve.guard import Rates
from ha2g_jax.motion import formats
from ha2g_jax.motion.control import Controls
from ha2g_jax.motion.control.parts import rest_pose
from ha2g_jax.synthesis import Style


@pytest.mark.parametrize("suffix", ["npz", "glb"])
def test_files_are_those_of_generate(client, debug_model, suffix, tmp_path):
    (tmp_path / "a.wav").write_bytes(wav(1))
    options = {"style": Style(mixture={"ada": 1.0, "ben": 3.0}), "seed": 4, "controls": Controls(energy=0.5)}
    motion = debug_model.generate(tmp_path / "a.wav", **options)
    formats.export(motion, tmp_path / f"out.{suffix}")
    answer = client.post(f"format={suffix}&style=ada:1,ben:3&seed=4&energy=0.5", wav(1))
    assert answer.status == 200 and answer.body == (tmp_path / f"out.{suffix}").read_bytes()


def test_a_rig_gives_its_joints(client):
    assert b"ROOT mixamorig:Hips" in client.post("format=bvh&rig=mixamo", wav(1)).body


BAD_REQUESTS = {
    "rig": ("rig=poser", None, 422, "no rig poser; expected one of ha2g, mixamo"),
    "rig of vrma": ("format=vrma&rig=unity", None, 422, "takes the rig vrm, not unity"),
    "unknown name": ("formats=npz", None, 422, "formats: no such name"),
    "great seed": ("seed=99999999999999999999", None, 422, "seed: "),
    "nan": ("energy=nan", None, 422, "the energy is nan"),
    "speaker": ("speaker=eve", None, 422, "no speaker 'eve' in the model; expected one of: ada, ben"),
    "variation": ("variation=1", None, 422, "the variation is that of a speaker or a mixture"),
    "late mute": ("mute=20:21", None, 422, "after the end of the motion"),
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


def test_a_warning_about_sound_has_the_name_that_the_client_gave(client, caplog):
    client.post("speaker=eve", wav(0.3)[:44] + bytes(9600))  # which is refused after the sound is read
    assert [record.getMessage() for record in caplog.records] == ["a.wav is silent"]


def test_a_body_that_is_no_form_with_one_file_is_refused(client):
    for kind in ("application/json", "audio/wav", "multipart/form-data", "application/x-www-form-urlencoded"):
        answer = client.ask("POST", "/v1/motion", b"a=b", {"Content-Type": kind})
        assert answer.status == 400 and "-F speech=@speech.wav" in answer.error
    assert client.ask("POST", "/v1/motion", b"", {"Content-Length": "1e9"}).status == 400
    assert client.ask("GET", "/v1/motion").status == 405
    assert client.post("", wav(0.3), name="sound").status == 400
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
    with running(debug_model, upload_seconds=0.1) as client, client.begin_upload(b"--x", 100) as upload:
        assert upload.recv(100).startswith(b"HTTP/1.1 408 ")


def test_a_client_that_leaves_is_no_fault_of_the_service(client, caplog):
    with client.begin_upload(b"--x", 100):
        while not client.service.motions.taken:
            time.sleep(0.01)
    while client.service.motions.taken:
        time.sleep(0.01)
    assert client.ask("GET", "/health").status == client.ask("HEAD", "/health").status == 200 and not caplog.records


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
        for path in ("/", "/metrics"):
            assert client.ask("GET", path, None, {"Origin": "https://evil.example"}).status == 403


def test_a_page_of_a_named_origin_may_send_a_file_and_read_the_answer(debug_model):
    """A browser asks first, without the token, and shows the page only what is allowed by the answer."""
    asked = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization"}
    allowed = "Access-Control-Allow-Origin"
    with running(debug_model, origins=("https://good.example",), token=TOKEN) as client:
        for origin, expected in (("https://good.example", "https://good.example"), ("https://evil.example", None)):
            answer = client.ask("OPTIONS", "/v1/motion", None, {"Origin": origin} | asked)
            assert (answer.status == 200, answer.headers[allowed]) == (expected is not None, expected)
        answer = client.post("", wav(0.3), Origin="https://good.example", Authorization=f"Bearer {TOKEN}")
        assert (answer.status, answer.headers[allowed]) == (200, "https://good.example")


HOSTS = {  # of a request -> status without a token, and with one
    "127.0.0.1:8000": (200, 200),
    "LOCALHOST": (200, 200),
    "[::1]:8000": (200, 200),
    "named.example:443": (200, 200),
    "10.1.2.3:8000": (421, 200),  # a probe of Kubernetes; no page can make its own name an address
    "[fd00::1]": (421, 200),
    "": (421, 200),
    "evil.example": (421, 421),
    "localhost.evil.example": (421, 421),
    "localhost@evil.example": (421, 421),
    "[::1": (421, 421),
}


@pytest.mark.parametrize("token", [None, TOKEN])
def test_hosts_are_named_or_loopback(debug_model, token):
    """A page whose own name was pointed at this machine has a host and an origin that are equal."""
    with running(debug_model, origins=("https://named.example",), token=token) as client:
        for host, statuses in HOSTS.items():
            headers = {"Host": host, "Authorization": f"Bearer {token}"}
            for path in ("/health", "/", "/metrics"):
                assert client.ask("GET", path, None, headers).status == statuses[token is not None], (host, path)
        own = {"Host": "evil.example", "Origin": "http://evil.example"}
        answer = client.post("", wav(0.3), **own, Authorization=f"Bearer {token}")
        assert answer.status == 421 and "name it with --host, or --origin" in answer.error
        with socket.create_connection(("127.0.0.1", client.port), timeout=20) as plain:
            handshake = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
            names = f"Host: evil.example\r\nOrigin: http://evil.example\r\n{handshake}{key}"
            plain.sendall(f"GET /v1/stream?token={token} HTTP/1.1\r\n{names}".encode())
            assert plain.recv(100).startswith(b"HTTP/1.1 421 ")


FAULTS = {
    "full disk": (OSError(errno.ENOSPC, "No space left on device"), 507, "the disk of the service is full"),
    "quota": (OSError(errno.EDQUOT, "Disk quota exceeded"), 507, "the disk of the service is full"),
    "read-only": (OSError(errno.EROFS, "Read-only file system"), 503, "cannot write temporary files"),
}


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("where", ["tempfile.TemporaryDirectory", "shutil.copyfileobj", "pathlib.Path.replace"])
def test_a_disk_that_takes_nothing_is_a_sentence_and_a_line(client, monkeypatch, caplog, name, where):
    error, status, message = FAULTS[name]

    def fail(*_, **__):
        raise error

    monkeypatch.setattr(where, fail)
    answer = client.post("", wav(0.3))
    assert answer.status == status and message in answer.error and "/tmp" not in answer.error
    (line,) = caplog.records
    assert str(error.strerror).lower() in line.getMessage() and line.exc_info is None


def test_the_folder_of_temporary_files_may_be_removed(client, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(client.service, "folder", str(tmp_path / "gone"))
    monkeypatch.setenv("PROMETHEUS_MULTIPROC_DIR", str(tmp_path / "gone"))
    for answer in (client.post("", wav(0.3)), client.ask("GET", "/metrics")):
        assert answer.status == 503 and "cannot write temporary files" in answer.error
    assert len(caplog.records) == 2 and not any(line.exc_info for line in caplog.records)


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


def test_the_page_has_all_it_needs_and_runs_nothing_else(client):
    answer = client.ask("GET", "/")
    assert answer.status == 200 and answer.headers["Content-Type"] == "text/html; charset=utf-8"
    page = Page(answer.body.decode())
    links = [attributes.get(name) for _, attributes, _ in page.elements for name in ("src", "href", "data", "action")]
    assert set(filter(None, links)) == {"data:,"}
    assert not [name for name in page.attributes if name.startswith("on") or name == "style"]
    rules = dict(rule.split(" ", 1) for rule in answer.headers["Content-Security-Policy"].split("; "))
    assert rules["default-src"] == "'none'" and rules["connect-src"] == "'self'" and "unsafe" not in str(rules)
    assert rules["base-uri"] == rules["form-action"] == rules["frame-ancestors"] == "'none'"
    for name, tag in (("script-src", "script"), ("style-src", "style")):
        run = [text for found, attributes, text in page.elements if found == tag and not attributes]
        hashes = {base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in run}
        assert len(run) >= 1 and set(re.findall(r"'sha256-([^']+)'", rules[name])) == hashes
    assert answer.headers["X-Content-Type-Options"] == "nosniff" and "no-store" in answer.headers["Cache-Control"]


def test_the_page_has_the_skeleton_of_the_model(client, debug_model):
    skeleton = debug_model.assets.skeleton
    content = content_of(client.ask("GET", "/").body)
    assert content["figure"]["joints"] == list(skeleton.joints) and content["figure"]["fps"] == 15
    assert content["speakers"] == ["ada", "ben"] and content["source"] == "sound"
    np.testing.assert_allclose(np.reshape(content["figure"]["rest"], (-1, 3)), rest_pose(skeleton), atol=1e-4)


def content_of(page):
    return json.loads(Page(page.decode()).of("content"))


def test_the_page_alone_needs_no_token_and_names_nobody(debug_model):
    with running(debug_model, token=TOKEN) as client:
        answer = client.ask("GET", "/")
        assert answer.status == 200 and content_of(answer.body)["needsToken"] is True
        assert content_of(answer.body)["speakers"] == [] and TOKEN.encode() not in answer.body
        assert client.ask("GET", "//").status == client.ask("GET", "/v1/stream").status == 401
        assert client.ask("GET", "/v1/stream", None, {"Authorization": f"Bearer {TOKEN}"}).status == 426
