"""The recipe of docs/robots.md: Pepper's arms point where those of a motion do, and follow a conversation."""

import concurrent.futures
import contextlib
import dataclasses
import json
import pathlib
import socket
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ha2g_jax.apps.live.clock import StopFlag
from ha2g_jax.apps.live.run import run
from ha2g_jax.apps.live.sinks import open_sinks
from ha2g_jax.apps.live.sources import open_source
from ha2g_jax.motion import rotations, solver
from ha2g_jax.motion.armature import world
from ha2g_jax.motion.formats import export
from ha2g_jax.motion.lower_body import LowerBody
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_expressive")


@pytest.fixture(scope="module")
def recipe() -> dict:
    text = (pathlib.Path(__file__).parent.parent / "docs" / "robots.md").read_text()
    names: dict = {}
    for block in text.split("```python\n")[1:]:
        exec(block.split("```")[0], names)
    return names


def pepper(angles: dict, letter: str, tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3) directions of upper arm and forearm in the chest's axes, by the joints' order and axes in the URDF."""
    upper = Rotation.from_rotvec(angles[f"{letter}ShoulderPitch"][:, None] * [0, 1, 0])
    upper = upper * Rotation.from_rotvec(angles[f"{letter}ShoulderRoll"][:, None] * [0, 0, 1])
    fore = upper * Rotation.from_rotvec([0, tilt, 0])
    fore = fore * Rotation.from_rotvec(angles[f"{letter}ElbowYaw"][:, None] * [1, 0, 0])
    fore = fore * Rotation.from_rotvec(angles[f"{letter}ElbowRoll"][:, None] * [0, 0, 1])
    return upper.apply([1, 0, 0]), fore.apply([1, 0, 0])


def test_arms_point_where_the_motions_do(recipe, tmp_path):
    time = np.arange(20)[:, None] / 15
    directions = np.repeat(SKELETON.mean_directions[None], 20, axis=0)
    for side, out in (("left", 1), ("right", -1)):  # ahead and a little out; y is down and -z ahead in a motion
        upper = np.concatenate(
            [out * (0.4 + 0.2 * np.sin(3 * time)), 0.8 + 0 * time, -0.5 - 0.2 * np.cos(2 * time)], axis=1
        )
        fore = np.concatenate([-out * 0.3 * np.sin(2 * time), -0.2 + 0.3 * np.cos(3 * time), -0.9 + 0 * time], axis=1)
        directions[:, SKELETON.bone("nose"), 0] = 0.3 * np.sin(4 * time[:, 0])
        directions[:, SKELETON.bone(f"{side}_elbow")], directions[:, SKELETON.bone(f"{side}_wrist")] = upper, fore
    motion = Motion.from_directions(SKELETON, directions, 15)
    export(motion, tmp_path / "m.json")
    file = json.loads((tmp_path / "m.json").read_text())
    angles = recipe["pepper_angles"](file["joints"], file["frames"])
    animation = solver.animate(motion)
    chest = rotations.conjugate(animation.rotations[:, 0])
    head = world(animation)[0][:, animation.armature.joint("head")]
    ours = rotations.rotate(rotations.multiply(chest, head), np.array([0.0, 0.0, 1.0]))[:, [2, 0, 1]]
    turned = Rotation.from_euler("ZY", np.stack([angles["HeadYaw"], angles["HeadPitch"]], axis=1))
    np.testing.assert_allclose(turned.apply([1, 0, 0]), ours, atol=1e-3)
    for side, letter in (("left", "L"), ("right", "R")):
        found = pepper(angles, letter, recipe["ELBOW_TILT"])
        for end, bone in zip(("elbow", "wrist"), found, strict=True):
            ours = rotations.rotate(chest, motion.directions[:, SKELETON.bone(f"{side}_{end}")] * [1, -1, -1])
            angle = np.degrees(np.arccos(np.clip(np.sum(ours[:, [2, 0, 1]] * bone, axis=1), -1, 1)))
            assert angle.max() < 0.2, (side, end)
    for name, (low, high, _) in recipe["LIMITS"].items():
        assert ((angles[name] >= low) & (angles[name] <= high)).all()


def test_an_elbow_that_cannot_follow_stays_at_its_limit(recipe):
    """In a file as in a stream it is not at the other one while the yaw is beyond 180 degrees."""
    wanted = np.radians([100, 140, 170, -170, -140, 170, 130, 20, -60, 10])
    is_defined = np.array([True] * 8 + [False, True])
    expected = np.radians([100, *[119.5] * 6, 20, 20, 10])
    np.testing.assert_allclose(recipe["within"]("LElbowYaw", wanted, is_defined, None), expected, atol=1e-3)
    now = None
    for angle, defined, each in zip(wanted, is_defined, expected, strict=True):
        (now,) = recipe["within"]("LElbowYaw", [angle], [defined], now)
        assert now == pytest.approx(each, abs=1e-3)


def test_a_motion_that_is_too_fast_is_played_slower(recipe):
    angles = {name: np.zeros(3) for name in recipe["LIMITS"]}
    assert recipe["slower"](angles, 15) == 1
    angles["LShoulderPitch"] = np.array([0, 1, 0])
    assert recipe["slower"](angles, 15) == pytest.approx(15 / 7.33998)


def test_a_robot_follows_a_conversation(recipe, debug_model):
    with socket.create_server(("127.0.0.1", 0)) as free:
        source = f"ws://127.0.0.1:{free.getsockname()[1]}"
    stop = StopFlag()

    def events():
        time.sleep(0.5)
        yield {"state": "think"}
        yield {"cue": "nod"}
        time.sleep(1.2)
        yield (8000 * np.sin(np.arange(32000) / 9)).astype("<i2").tobytes()
        time.sleep(0.9)
        yield "interrupted"
        yield {"state": "listen"}
        time.sleep(1.6)

    def talk():
        try:
            while not stop.is_asked():
                with contextlib.suppress(ConnectionRefusedError):  # until it listens
                    recipe["converse"](events(), source)
                    return
                time.sleep(0.05)
        finally:
            stop.ask()

    def datagrams():
        while not stop.is_asked():
            with contextlib.suppress(TimeoutError):
                yield robot.recv(65536)

    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot,
        contextlib.ExitStack() as stack,
        concurrent.futures.ThreadPoolExecutor(2) as threads,
    ):
        robot.bind(("127.0.0.1", 0))
        robot.settimeout(0.5)
        sinks = open_sinks([f"udp://127.0.0.1:{robot.getsockname()[1]}"], stack)
        moved: list[dict[str, float]] = []
        following = threads.submit(recipe["follow"], datagrams(), moved.append)
        talking = threads.submit(talk)
        run(debug_model, open_source(source), sinks, stop=stop)
        talking.result()
        following.result()
    limits = recipe["LIMITS"]
    angles = np.array([[pose[name] for name in limits] for pose in moved])
    low, high, fastest = np.array(list(limits.values())).T
    assert (angles >= low).all() and (angles <= high).all()
    steps = np.abs(np.diff(angles, axis=0)) * debug_model.spec.fps
    assert (steps <= fastest + 1e-6).all()
    assert np.ptp(angles, axis=0).max() > 0.5  # a hand is raised to think
    assert steps[-5:].max() < 0.3 < steps.max()  # still after the interruption


def test_a_person_who_turns_has_the_angles_of_one_who_does_not(recipe, tmp_path):
    """In a file with a pelvis the chest is no longer the root."""
    directions = np.repeat(SKELETON.mean_directions[None], 20, axis=0)
    motion, found = Motion.from_directions(SKELETON, directions, 15), []
    turns = Rotation.from_rotvec(np.linspace(-1, 1, 20)[:, None] * [0, 1, 0]).as_quat()
    offsets = np.zeros((10, 3))
    offsets[1:] = np.array([0, -0.2, 0]) + np.random.default_rng(0).normal(0, 0.05, (9, 3))
    lower = LowerBody(offsets, np.repeat(turns[:, None], 9, axis=1), np.zeros((20, 3)))
    for each in (motion, dataclasses.replace(motion, lower=lower)):
        export(each, tmp_path / "m.json")
        file = json.loads((tmp_path / "m.json").read_text())
        found.append(recipe["pepper_angles"](file["joints"], file["frames"]))
    for name in found[0]:
        np.testing.assert_allclose(found[0][name], found[1][name], atol=1e-3, err_msg=name)
