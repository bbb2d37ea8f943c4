"""Receivers get all frames with the values of the files; what cannot be opened is said in one line."""

import contextlib
import importlib.util
import json
import pathlib
import socket
import subprocess
import sys
import time
import types
import urllib.error
import urllib.request

import numpy as np
import pytest
from apps.live.standins import FPS, poses
from pythonosc import dispatcher
from scipy.spatial.transform import Rotation
from websockets.sync.client import connect

from ha2g_jax.apps.live import sinks
from ha2g_jax.apps.live.clock import Clock, StopFlag
from ha2g_jax.apps.live.frames import Rigs
from ha2g_jax.apps.live.network import read_address, udp_target
from ha2g_jax.apps.live.sinks import MAX_DATAGRAM, VmcSink, open_sinks
from ha2g_jax.apps.live.sources import open_source
from ha2g_jax.errors import UserError
from ha2g_jax.motion.armature import world
from ha2g_jax.viewer.page import live_page

LARGEST_DATAGRAM = 9216  # macOS sends no longer ones by default


def check_message(message, frame, rig):
    animation = frame.animations[rig]
    _, positions = world(animation)
    assert (message["type"], message["frame"]) == ("frame", frame.number)
    assert message["time"] == pytest.approx(frame.seconds, abs=1e-6)
    np.testing.assert_allclose(message["positions"], positions[0], atol=1e-6)
    np.testing.assert_allclose(message["rotations"], animation.rotations[0], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(message["directions"], axis=-1).max(), 1, atol=1e-5)


@pytest.mark.parametrize("rig", ["ha2g", "mixamo", "smplx", "unity", "unreal", "vrm"])
def test_datagrams_are_the_joints_once_a_second_and_every_frame(make_frames, receiver, rig):
    frames, (bound, port), received = make_frames(17, rig), receiver, []
    with contextlib.ExitStack() as stack:
        (sink,) = open_sinks([f"udp://127.0.0.1:{port}"], stack, rig).senders
        for frame in frames:
            sink.send(frame)
            for _ in range(2 if frame.number % 15 == 0 else 1):
                datagram = bound.recv(65_536)
                assert len(datagram) <= LARGEST_DATAGRAM
                received.append(json.loads(datagram))
    joints, poses = ([it for it in received if it["type"] == kind] for kind in ("joints", "frame"))
    assert len(joints) == 2
    assert received[0] == joints[0] == joints[1]
    assert (joints[0]["rig"], joints[0]["fps"]) == (rig, 15)
    assert [joint["name"] for joint in joints[0]["joints"]] == list(frames[0].animations[rig].armature.joints)
    for message, frame in zip(poses, frames, strict=True):
        check_message(message, frame, rig)


def test_frames_that_are_converted_at_once_are_those_of_one_after_another(skeleton):
    directions, rigs = poses(skeleton, 9), [Rigs(skeleton, FPS, ["ha2g", "vrm"]) for _ in range(2)]
    pieces = [*rigs[0].convert(directions[:5]), *rigs[0].convert(directions[:0]), *rigs[0].convert(directions[5:])]
    for whole, alone in zip(pieces, map(rigs[1].convert, directions[:, None]), strict=True):
        for name in ("ha2g", "vrm"):
            assert whole[name].num_frames == len(whole[name].translation) == 1
            np.testing.assert_allclose(whole[name].rotations, alone[0][name].rotations, atol=1e-9)


def test_every_page_gets_the_joints_and_then_all_frames(make_frames, free_port):
    frames, url = make_frames(6, "ha2g"), f"ws://127.0.0.1:{free_port()}"
    with contextlib.ExitStack() as stack:
        (sink,) = open_sinks([url], stack).senders
        sink.send(frames[0])  # nobody is there
        pages = []
        for frame in frames[1:3]:
            pages.append(stack.enter_context(connect(url)))
            while len(sink._pages) < len(pages):  # type: ignore[attr-defined]
                pass
            sink.send(frame)
        for page, missed in zip(pages, (1, 2), strict=True):
            assert json.loads(page.recv(timeout=5))["type"] == "joints"
            for frame in frames[missed:3]:
                check_message(json.loads(page.recv(timeout=5)), frame, "ha2g")


def test_a_browser_gets_a_page_and_the_page_the_poses_of_the_model(make_frames, free_port, skeleton):
    frames, port = make_frames(2, "mixamo"), free_port()
    with contextlib.ExitStack() as stack:
        (sink,) = open_sinks([f"ws://127.0.0.1:{port}"], stack, "mixamo").senders
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=5) as answer:
            assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
            assert "connect-src 'self'" in answer.headers["Content-Security-Policy"]
            assert answer.read() == live_page("frames").content
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"http://127.0.0.1:{port}/page", timeout=5)
        page = stack.enter_context(connect(f"ws://127.0.0.1:{port}/page"))
        while not sink._pages:  # type: ignore[attr-defined]
            pass
        for frame in frames:
            sink.send(frame)
        assert json.loads(page.recv(timeout=5))["figure"]["joints"] == list(skeleton.joints)
        for frame in frames:
            message = json.loads(page.recv(timeout=5))
            assert message["first"] == frame.number
            np.testing.assert_allclose(np.reshape(message["frames"], (-1, 3)), frame.directions, atol=5.1e-5)


def test_a_page_that_does_not_read_is_dropped_by_name(make_frames, free_port, monkeypatch, capsys):
    (frame,), url, count = make_frames(1, "ha2g"), f"ws://127.0.0.1:{free_port()}", 400
    monkeypatch.setattr(sinks, "frame_message", lambda frame, animation: "x" * 100_000)
    monkeypatch.setattr(sinks, "_SILENT", 0.2)
    with contextlib.ExitStack() as pages, contextlib.ExitStack() as stack:
        (sink,) = open_sinks([url], stack).senders
        stuck = pages.enter_context(connect(url, max_queue=1, close_timeout=0.1))
        port = stuck.socket.getsockname()[1]
        reader = pages.enter_context(connect(url, max_queue=None))
        while len(sink._pages) < 2:  # type: ignore[attr-defined]
            pass
        for number in range(count):  # 40 MB
            sink.send(frame)
            assert len(reader.recv(timeout=5)) == 100_000 or number == 0
            time.sleep(0.002)
        assert len(reader.recv(timeout=5)) == 100_000
        assert len(sink._pages) == 1  # type: ignore[attr-defined]
        assert capsys.readouterr().err.splitlines()[1:] == [
            f"{url} drops the page at 127.0.0.1, port {port}, which does not read"
        ]


def test_a_page_may_read_again_while_it_is_asked_whether_it_reads(monkeypatch):
    page = sinks._Page(types.SimpleNamespace(send=str, request=types.SimpleNamespace(path=""), remote_address=("", 0)))
    while not page.messages.full():
        page.put("")
    monkeypatch.setattr(sinks, "time", types.SimpleNamespace(monotonic=lambda: page.send("") or 0.0))
    assert page.put("") and page.put("")


def test_a_run_ends_although_a_page_does_not_read(make_frames, free_port, monkeypatch):
    (frame,), url = make_frames(1, "ha2g"), f"ws://127.0.0.1:{free_port()}"
    monkeypatch.setattr(sinks, "frame_message", lambda frame, animation: "x" * 100_000)
    monkeypatch.setattr(sinks, "_SILENT", 0.5)
    with contextlib.ExitStack() as pages, contextlib.ExitStack() as stack:
        (sink,) = open_sinks([url], stack).senders
        pages.enter_context(connect(url, max_queue=1, close_timeout=0.1))
        while not sink._pages:  # type: ignore[attr-defined]
            pass
        for _ in range(300):  # 30 MB, of which most frames are missed
            sink.send(frame)
        begun = time.monotonic()
        stack.close()
        assert time.monotonic() - begun < 5


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["smoke://127.0.0.1:1"], r"no sink smoke://127.0.0.1:1; expected vmc://HOST:PORT"),
        (["udp://127.0.0.1:70000"], "out of range; give one from 1 to 65535"),
        (["ws://[::1:1"], "cannot read the address"),
        (["udp://nowhere.invalid:1"], "no host nowhere.invalid"),
        (["udp://127.0.0.1:9", "udp://127.0.0.1:9"], "the same"),
        (["none/a.npz", "./none/a.npz"], "the same"),
        (["/proc/none/a.npz"], "cannot write /proc/none/a.npz"),
    ],
)
def test_a_sink_that_cannot_be_used_is_said_in_one_line(texts, message):
    with pytest.raises(UserError, match=message) as error, contextlib.ExitStack() as stack:
        open_sinks(texts, stack)
    assert "\n" not in str(error.value)


def test_a_host_with_addresses_of_both_kinds_is_reached_by_ipv4(monkeypatch):
    kinds = (socket.SOCK_DGRAM, socket.IPPROTO_UDP, "")
    found = [(socket.AF_INET6, *kinds, ("::1", 9, 0, 0)), (socket.AF_INET, *kinds, ("127.0.0.1", 9))]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    sender, target = udp_target(read_address("udp://localhost:9"))
    assert sender.getsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST)
    with sender:
        assert sender.family == socket.AF_INET and target == ("127.0.0.1", 9)


def test_an_address_in_use_and_a_rig_that_does_not_exist(free_port):
    url = f"ws://127.0.0.1:{free_port()}"
    with contextlib.ExitStack() as stack:
        open_sinks([url], stack)
        with pytest.raises(UserError, match=r"cannot listen on ws://127\.0\.0\.1:\d+ \(address already in use\); give"):
            next(open_source(url).chunks(Clock(), StopFlag()))
    with pytest.raises(UserError, match="no rig lego"), contextlib.ExitStack() as stack:
        open_sinks(["udp://127.0.0.1:9"], stack, "lego")


@pytest.mark.parametrize(
    "pair",
    [
        ("vmc://127.0.0.1", "vmc://127.0.0.1:39539"),
        ("vmc://127.0.0.1:39539", "VMC://127.0.0.1:39539/"),
        ("udp://LOCALHOST:9", "udp://localhost:9"),
        ("m.npz", "./m.npz"),
    ],
)
def test_a_receiver_that_is_given_twice_is_refused(pair):
    with pytest.raises(UserError, match="two sinks are the same"), contextlib.ExitStack() as stack:
        open_sinks(pair, stack)


# The hierarchy of a Unity humanoid, as any receiver knows it.
TRUNK = ("root", "Hips", "Spine", "Chest", "UpperChest", "Neck", "Head")
ARM = ("Shoulder", "UpperArm", "LowerArm", "Hand")
LEG = ("UpperLeg", "LowerLeg", "Foot", "Toes")
FINGERS = ("Thumb", "Index", "Middle", "Ring", "Little")
PARENTS = dict(zip(TRUNK[1:], TRUNK, strict=False))
for side in ("Left", "Right"):
    PARENTS |= {side + child: side + parent for child, parent in zip(ARM[1:], ARM, strict=False)}
    PARENTS |= {side + child: side + parent for child, parent in zip(LEG[1:], LEG, strict=False)}
    PARENTS |= {f"{side}Shoulder": "UpperChest", f"{side}UpperLeg": "Hips"}
    for finger in FINGERS:
        chain = [f"{side}Hand", *(f"{side}{finger}{part}" for part in ("Proximal", "Intermediate", "Distal"))]
        PARENTS |= dict(zip(chain[1:], chain, strict=False))


def forward_kinematics(bones):
    """Return positions by name from local positions and rotations, in the axes of the receiver."""
    placed = {}

    def place(name):
        if name not in placed:
            position, rotation = np.array(bones[name][0]), Rotation.from_quat(bones[name][1])
            if name != "root":
                above, turned = place(PARENTS[name])
                position, rotation = above + turned.apply(position), turned * rotation
            placed[name] = position, rotation
        return placed[name]

    return {name: place(name)[0] for name in bones}


def check_joints(bones, frame):
    """Check that the joints of a receiver are ours to a millimetre, and return them."""
    found, animation = forward_kinematics(bones), frame.animations["unity"]
    _, ours = world(animation)
    for name, position in zip(animation.armature.joints, ours[0], strict=True):
        np.testing.assert_allclose(found[name], position * [-1, 1, 1], atol=1e-3)
    return found


def test_the_messages_are_those_of_the_protocol(receiver, make_frames):
    frame, (bound, port) = make_frames(3, "unity")[2], receiver
    with contextlib.closing(VmcSink(read_address(f"vmc://127.0.0.1:{port}"))) as sink:
        sink.send(frame)
    datagrams = [bound.recv(65_536)]
    while b"RightToes" not in datagrams[-1]:
        datagrams.append(bound.recv(65_536))
    assert max(map(len, datagrams)) <= MAX_DATAGRAM
    found = []
    handlers = dispatcher.Dispatcher()
    handlers.set_default_handler(lambda address, *values: found.append((address, *values)))
    for datagram in datagrams:
        handlers.call_handlers_for_packet(datagram, ("127.0.0.1", 0))
    assert found[0] == ("/VMC/Ext/OK", 1)
    assert found[1] == ("/VMC/Ext/T", pytest.approx(2 / 15))
    assert found[2] == ("/VMC/Ext/Root/Pos", "root", 0, 0, 0, 0, 0, 0, 1)
    assert {message[0] for message in found[3:]} == {"/VMC/Ext/Bone/Pos"}
    bones = {name: ((x, y, z), rotation) for _, name, x, y, z, *rotation in found[3:]}
    assert set(bones) == set(PARENTS)
    assert all(len(rotation) == 4 and abs(np.linalg.norm(rotation) - 1) < 1e-6 for _, rotation in bones.values())
    placed = check_joints(bones | {"root": ((0, 0, 0), (0, 0, 0, 1))}, frame)
    assert placed["LeftHand"][0] < 0 < placed["RightHand"][0]  # Unity's figures face +z, their left is at -x


def test_the_joints_of_a_receiver_are_ours_to_a_millimetre(make_frames, free_port):
    """vmcp (PyPI, AGPL; not installed by default) receives; `pip install "vmcp[osc4py3]"` runs this test."""
    if importlib.util.find_spec("vmcp") is None or importlib.util.find_spec("osc4py3") is None:
        pytest.skip("no receiver of the VMC protocol here (pip install 'vmcp[osc4py3]')")
    port = free_port(socket.SOCK_DGRAM)
    frame = make_frames(8, "unity")[-1]
    script = pathlib.Path(__file__).parent / "vmc_receiver.py"
    with subprocess.Popen([sys.executable, str(script), str(port)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        with contextlib.closing(VmcSink(read_address(f"vmc://127.0.0.1:{port}"))) as sink:
            sink.send(frame)
        bones = json.loads(process.stdout.readline())
    assert set(bones) == {*PARENTS, "root"}
    check_joints(bones, frame)
