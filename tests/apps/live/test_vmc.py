"""Receivers of the VMC protocol that this project did not write read bones whose joints are where ours are."""

import importlib.util
import json
import pathlib
import socket
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ha2g_jax.apps.live.network import read_address
from ha2g_jax.apps.live.sinks import MAX_DATAGRAM, VmcSink
from ha2g_jax.motion.armature import world

dispatcher = pytest.importorskip("pythonosc.dispatcher")

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


@pytest.fixture
def receiver(free_port):
    """A UDP socket, and a sink that sends to it."""
    port = free_port(socket.SOCK_DGRAM)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bound:
        bound.bind(("127.0.0.1", port))
        bound.settimeout(0.5)
        sink = VmcSink(read_address(f"vmc://127.0.0.1:{port}"))
        yield bound, sink
        sink.close()


def receive_all(bound):
    datagrams = []
    try:
        while not datagrams or b"RightToes" not in datagrams[-1]:
            datagrams.append(bound.recv(65_536))
    except TimeoutError:
        pass
    return datagrams


def test_the_messages_are_those_of_the_protocol(receiver, make_frames):
    bound, sink = receiver
    frame = make_frames(3, "unity")[2]
    sink.send(frame)
    datagrams = receive_all(bound)
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
        sink = VmcSink(read_address(f"vmc://127.0.0.1:{port}"))
        sink.send(frame)
        sink.close()
        bones = json.loads(process.stdout.readline())
    assert set(bones) == {*PARENTS, "root"}
    check_joints(bones, frame)
