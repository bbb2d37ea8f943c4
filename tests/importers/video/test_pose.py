"""Estimators run in their own process; whatever they do wrong is one line, and no process stays behind."""

import os
import pathlib
import shlex
import signal
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
from fixtures.videos import make_video

from ha2g_jax.errors import UserError
from ha2g_jax.importers.video import pose
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_expressive")


def arrays(count: int = 8) -> dict[str, Any]:
    return {
        "positions": np.tile(SKELETON.mean_pose, (count, 1, 1)).astype(np.float32),
        "confidence": np.full((count, 43), 0.9, np.float32),
        "image_points": np.full((count, 43, 2), 20, np.float32),
    }


@pytest.fixture
def estimator(tmp_path):
    """The command of a program whose body is given; it knows `video` and `out`."""

    def command(body: str) -> str:
        script = tmp_path / "estimator.py"
        script.write_text(f"import sys, os, signal, time, numpy as np\nvideo, out = sys.argv[1:]\n{body}\n")
        return f"{shlex.quote(sys.executable)} {shlex.quote(str(script))} {{video}} {{out}}"

    return command


def saves(tmp_path: pathlib.Path, **changes) -> str:
    """The body of an estimator that writes well-formed poses with some changes; None takes an array away."""
    stored = tmp_path / "stored.npz"
    np.savez(stored, **{name: value for name, value in {**arrays(), **changes}.items() if value is not None})
    return f"import shutil; shutil.copy({str(stored)!r}, out)"


def message(video: pathlib.Path, command: str) -> str:
    with pytest.raises(UserError) as caught:
        pose.estimate(video, command=command)
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 800
    return text


def test_what_the_command_writes_comes_back(tmp_path, estimator):
    confidence = arrays()["confidence"]
    confidence[2, 5] = 0
    positions = arrays()["positions"].astype(np.float64)
    positions[2, 5] = 7
    body = saves(tmp_path, confidence=confidence, positions=positions)
    video = tmp_path / "a {out} video.mp4"
    found = pose.estimate(video, command=estimator(f"assert video == {str(video)!r}; {body}"))
    assert found.positions.shape == (8, 43, 3)
    assert {array.dtype for array in found[:3]} == {np.dtype(np.float32)}
    assert np.isnan(found.positions[2, 5]).all()
    assert np.isnan(found.image_points[2, 5]).all()
    assert np.isfinite(found.positions).sum() == 8 * 43 * 3 - 3


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"positions": None}, "no 'positions'"),
        ({"positions": np.zeros((8, 42, 3))}, "shape ('T', 43, 3)"),
        ({"confidence": np.ones((7, 43))}, "shape ('T', 43)"),
        ({"image_points": np.full((8, 43, 2), "x")}, "image_points"),
        ({"positions": np.full((8, 43, 3), np.nan)}, "no finite position"),
        ({"positions": np.full((8, 43, 3), 5000.0)}, "expected metres"),
        ({"confidence": np.full((8, 43), 80.0)}, "expected 0 to 1"),
        (dict.fromkeys(("positions", "confidence", "image_points"), np.zeros((0, 43, 3))), "expected"),
        ({"positions": np.array([{}])}, "pickle"),
    ],
)
def test_what_is_wrong_in_its_file_is_said(tmp_path, estimator, changes, part):
    text = message(tmp_path / "talk.mp4", estimator(saves(tmp_path, **changes)))
    assert part in text
    assert "talk.mp4" in text


@pytest.mark.parametrize(
    ("body", "part"),
    [
        ("raise ValueError('no such model')", "no such model"),
        ("sys.exit(3)", "exit code 3"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "SIGKILL"),
        ("print('all well')", "wrote no file"),
        ("open(out, 'wb').write(b'garbage' * 100)", "not a whole .npz"),
        ("open(out, 'wb')", "empty"),
    ],
)
def test_how_it_failed_is_said(tmp_path, estimator, body, part):
    text = message(tmp_path / "talk.mp4", estimator(body))
    assert part in text
    assert "talk.mp4" in text


@pytest.mark.parametrize(
    ("command", "part"),
    [
        ("estimate {video}", "{out}"),
        ("estimate '{video} {out}", "quotes"),
        ("/no/such/program {video} {out}", "cannot be started"),
    ],
)
def test_commands_that_cannot_run_are_refused(tmp_path, command, part):
    assert part in message(tmp_path / "talk.mp4", command)


def test_it_sees_no_foreign_libraries(tmp_path, estimator, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert "PYTHONPATH is None" in message(
        tmp_path / "talk.mp4", estimator("sys.exit(f'PYTHONPATH is {os.environ.get(\"PYTHONPATH\")}')")
    )


def test_an_interrupt_ends_it(tmp_path, estimator):
    note = tmp_path / "pid"

    main = threading.get_ident()

    def interrupt() -> None:
        while not (note.exists() and note.read_text()):
            time.sleep(0.01)
        signal.pthread_kill(main, signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        pose.estimate(
            tmp_path / "talk.mp4",
            command=estimator(f"open({str(note)!r}, 'w').write(str(os.getpid())); time.sleep(600)"),
        )
    thread.join()
    with pytest.raises(ProcessLookupError):
        os.kill(int(note.read_text()), 0)


# A stand-in for `holistic`: it says how bright each image is.
STAND_IN = """
import sys, struct, numpy as np
rows = []
while header := sys.stdin.buffer.read(8):
    width, height = struct.unpack("<2I", header)
    image = np.frombuffer(sys.stdin.buffer.read(3 * width * height), np.uint8)
    rows.append((image.mean(), width, height))
    BODY
rows = np.array(rows, np.float32)
hand = np.full((len(rows), 21, 3), np.nan, np.float32)
world = np.tile(np.random.default_rng(0).normal(0, 0.2, (33, 4)).astype(np.float32), (len(rows), 1, 1))
world[..., 3] = 1
image = np.tile(rows[:, None, :1], (1, 33, 2))
np.savez(sys.argv[1], world=world, image=image, left_hand=hand, right_hand=hand, sizes=rows[:, 1:])
"""


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    def use(body: str = "pass") -> None:
        script = tmp_path / "stand_in.py"
        script.write_text(STAND_IN.replace("BODY", body))
        monkeypatch.setattr(pose, "holistic_command", lambda: [sys.executable, str(script)])

    return use


def test_every_image_reaches_mediapipe_in_order(tmp_path, stand_in):
    stand_in()
    found = pose.estimate(make_video(tmp_path / "talk.mp4", seconds=2.0))
    nose = found.image_points[:, SKELETON.joint("nose"), 0]
    assert len(nose) == 20
    assert (np.diff(nose) >= 0).all()  # the images grow brighter by about one
    assert 15 < nose[-1] - nose[0] < 22
    assert (found.confidence[:, SKELETON.joint("nose")] == 1).all()
    assert (found.confidence[:, SKELETON.joint("left_thumb_1")] == 0).all()


def test_mediapipe_that_dies_midway_is_reported(tmp_path, stand_in):
    video = make_video(tmp_path / "talk.mp4", seconds=4.0)
    for body, part in (("sys.exit('out of luck')", "out of luck"), ("import os; os.kill(os.getpid(), 9)", "SIGKILL")):
        stand_in(body)
        with pytest.raises(UserError, match=part) as caught:
            pose.estimate(video)
        assert "talk.mp4" in str(caught.value)


def test_mediapipe_sees_the_real_speaker(tmp_path, private_data):
    try:
        pose.holistic_command()
    except UserError as error:
        pytest.skip(str(error))
    import av

    second = tmp_path / "second.mp4"
    with av.open(str(private_data / "video" / "sample.mp4")) as original, av.open(str(second), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "10", "preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = 1280, 720, "yuv420p"
        for number, frame in enumerate(original.decode(video=0)):
            if number == 24:
                break
            frame.pts = None
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    found = pose.estimate(second)
    assert len(found.positions) == 24
    assert (found.confidence > 0.5).all(axis=1).mean() > 0.8
    joint = {name: found.positions[:, number] for number, name in enumerate(SKELETON.joints)}
    drawn = {name: found.image_points[:, number] for number, name in enumerate(SKELETON.joints)}
    for places in (joint, drawn):
        assert (places["left_shoulder"][:, 0] > places["right_shoulder"][:, 0] + 0.2).all()
        assert (places["nose"][:, 1] < places["neck"][:, 1] - 0.03).all()
        assert (places["neck"][:, 1] < places["spine"][:, 1] - 0.15).all()
    for side in ("left", "right"):
        assert (joint[f"{side}_wrist"][:, 2] < joint[f"{side}_shoulder"][:, 2]).all()  # hands in front
        palm = np.linalg.norm(joint[f"{side}_middle_1"] - joint[f"{side}_wrist"], axis=-1)
        assert 0.06 < np.nanmedian(palm) < 0.12
    neck = joint["neck"] - joint["spine"]
    assert (np.linalg.norm(neck, axis=-1) < 0.3).all()
    assert (neck[:, 1] < -0.15).all()
