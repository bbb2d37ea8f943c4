"""What estimators of poses do wrong in their own process is one line; the environment of MediaPipe is whole or none."""

import importlib.resources
import os
import pathlib
import shlex
import signal
import subprocess
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
        ({"confidence": np.ones((7, 43))}, "shape ('T', 43)"),
        ({"positions": np.full((8, 43, 3), np.nan)}, "no finite position"),
        ({"positions": np.full((8, 43, 3), 5000.0)}, "expected metres"),
        ({"confidence": np.full((8, 43), 80.0)}, "expected 0 to 1"),
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
        ("os.kill(os.getpid(), signal.SIGKILL)", "SIGKILL"),
        ("print('all well')", "wrote no file"),
        ("sys.exit(f'PYTHONPATH is {os.environ.get(\"PYTHONPATH\")}')", "PYTHONPATH is None"),  # no foreign libraries
    ],
)
def test_how_it_failed_is_said(tmp_path, estimator, monkeypatch, body, part):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    text = message(tmp_path / "talk.mp4", estimator(body))
    assert part in text and "talk.mp4" in text


@pytest.mark.parametrize(
    ("command", "part"),
    [
        ("estimate {video}", "{out}"),
        ("/no/such/program {video} {out}", "cannot be started"),
    ],
)
def test_commands_that_cannot_run_are_refused(tmp_path, command, part):
    assert part in message(tmp_path / "talk.mp4", command)


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


PINS = (importlib.resources.files("ha2g_jax") / "assets" / "pose_requirements.txt").read_text()


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    """Nothing is made yet, and MediaPipe is taken to have wheels for the Python of the tests."""
    running = ".".join(map(str, sys.version_info[:2]))
    monkeypatch.setattr(pose, "_PYTHONS", (*pose._PYTHONS, running))
    monkeypatch.setenv("HA2G_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("HA2G_POSE_PYTHON", raising=False)
    return tmp_path / "cache"


@pytest.fixture
def made(empty_cache, monkeypatch) -> list[pathlib.Path]:
    """Environments are pretended to be made, and noted."""
    made = []

    def make(folder: pathlib.Path, interpreter: str, pins: str) -> None:
        made.append(folder)
        python = pose._interpreter(folder)
        python.parent.mkdir(parents=True)
        python.touch()
        (folder / "pyvenv.cfg").touch()

    monkeypatch.setattr(pose, "_make", make)
    return made


def test_it_is_made_once_under_the_cache(empty_cache, made):
    folder = pose.install()
    assert folder == empty_cache / "pose-0.10.21"
    assert pose.install() == folder
    assert len(made) == 1
    assert os.listdir(empty_cache) == [folder.name]  # noqa: PTH208
    python, *_, script = pose.holistic_command()
    assert python == str(pose._interpreter(folder))
    assert pathlib.Path(script).is_file()


def test_other_pins_make_it_anew(made):
    folder = pose.install()
    (folder / "requirements.txt").write_text("mediapipe==0.10.20\n")
    (folder / "old").touch()
    pose.install()
    assert len(made) == 2
    assert not (folder / "old").exists()


def test_a_folder_of_something_else_is_left_alone(empty_cache, made):
    folder = empty_cache / "pose-0.10.21"
    folder.mkdir(parents=True)
    (folder / "thesis.txt").touch()
    with pytest.raises(UserError, match="is not an environment"):
        pose.install()
    assert not made
    assert (folder / "thesis.txt").exists()


@pytest.mark.parametrize("error", [KeyboardInterrupt, UserError("no connection")])
def test_what_stops_it_leaves_nothing_behind(empty_cache, monkeypatch, error):
    def stop(folder: pathlib.Path, interpreter: str, pins: str) -> None:
        (folder / "lib").mkdir(parents=True)
        raise error

    monkeypatch.setattr(pose, "_make", stop)
    with pytest.raises((KeyboardInterrupt, UserError)):
        pose.install()
    assert not list(empty_cache.iterdir())


def test_without_a_connection_one_line_says_so(empty_cache, monkeypatch, capfd):
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    with pytest.raises(UserError, match=r"mediapipe==0\.10\.21") as caught:
        pose.install()
    assert "\n" not in str(caught.value)
    assert "PyPI" in str(caught.value)
    assert not list(empty_cache.iterdir())
    assert "ERROR" not in "".join(capfd.readouterr())  # of pip


def test_a_python_without_wheels_is_refused(empty_cache, tmp_path, monkeypatch):
    old = tmp_path / "python3.8"
    old.write_text("#!/bin/sh\necho 3 8 /usr/bin/python3.8\n")
    old.chmod(0o755)
    for name in (old, tmp_path / "absent", "no-such-python"):
        with pytest.raises(UserError, match=r"Python 3\.11 or 3\.12"):
            pose.install(python=name)
    monkeypatch.setattr(sys, "executable", str(old))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match=r"python3\.12"):
        pose.install()


def test_another_environment_may_be_named(empty_cache, monkeypatch):
    monkeypatch.setenv("HA2G_POSE_PYTHON", sys.executable)
    assert pose.holistic_command()[0] == sys.executable
    monkeypatch.setenv("HA2G_POSE_PYTHON", "/no/such/python")
    with pytest.raises(UserError, match="/no/such/python"):
        pose.holistic_command()


def test_the_estimator_needs_nothing_of_this_package():
    """Its environment has none of it: the program must not even try to import it."""
    script = importlib.resources.files("ha2g_jax") / "importers" / "video" / "holistic.py"
    code = f"""
import sys
sys.modules.update(dict.fromkeys(["ha2g_jax", "jax", "av", "scipy"]))
import runpy
runpy.run_path({str(script)!r})
"""
    subprocess.run([sys.executable, "-I", "-c", code], check=True)
