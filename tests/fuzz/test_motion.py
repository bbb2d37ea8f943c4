"""Every command with a motion refuses one that cannot be in one line, and leaves nothing of what it could not write."""

import os
import pathlib
from typing import Any

import numpy as np
import pytest
from fixtures.motions import swaying
from fuzz.conftest import within_limits

from ha2g_jax import cli

MOTION = swaying("ted_gesture", 6, size=0.2)
HOURS = {name: np.repeat(getattr(MOTION, name)[:1], 10_000, axis=0) for name in ("directions", "positions")}
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "deep meta": ({"meta": np.array("[" * 200_000 + "]" * 200_000)}, "nested too deep"),
    "fewer names": ({"joint_names": np.array(MOTION.joint_names[:3])}, "3 joints, not the 10"),
    "infinity": ({"positions": np.where(np.arange(3) == 1, np.inf, MOTION.positions)}, "in frame 0 is not a number"),
    "too slow": ({"fps": np.array(1e-4)}, "expected 0.1 to 1000"),
    "hours": (HOURS | {"fps": np.array(1.0)}, "10000 seconds"),
}
COMMANDS = (
    ("export", "{}", "-o", "{out}/x.glb"),
    ("view", "{}", "-o", "{out}/x.html"),
    ("video", "{}", "-o", "{out}/x.mp4"),
    ("keyframes", "{}", "-o", "{out}/x.png"),
    ("generate", "none.wav", "--pin", "0:1:{}"),
    ("evaluate", "--motion", "{folder}", "--reference", "{folder}"),
)


@pytest.fixture
def saved(tmp_path) -> pathlib.Path:
    MOTION.save(tmp_path / "m.npz")
    return tmp_path / "m.npz"


@pytest.mark.parametrize("name", BAD)
def test_every_command_refuses_it_in_one_line(name, refused, saved, tmp_path):
    changes, what = BAD[name]
    (tmp_path / "in").mkdir()
    np.savez(tmp_path / "in" / "m.npz", **(dict(np.load(saved)) | changes))
    paths = {"folder": tmp_path / "in", "out": tmp_path / "out"}
    for command in COMMANDS:
        line = refused(*(word.format(tmp_path / "in" / "m.npz", **paths) for word in command))
        assert what in line and "m.npz" in line, line
    assert not (tmp_path / "out").exists()


OUTPUTS = {
    ".glb": ("export",), ".vrma": ("export",), ".bvh": ("export",), ".json": ("export",), ".csv": ("export",),
    ".npz": ("export",), ".html": ("view",), ".svg": ("keyframes", "--size", "64"),
    ".png": ("keyframes", "--size", "64"), ".mp4": ("video", "--size", "64x64"),
}  # fmt: skip


@pytest.mark.parametrize("suffix", OUTPUTS)
def test_a_full_disk_is_one_line_and_leaves_nothing(suffix, refused, saved, tmp_path):
    (tmp_path / "out").mkdir()
    # The temporary file is one that accepts no byte.
    (tmp_path / "out" / f".x.{os.getpid()}{suffix}").symlink_to("/dev/full")
    command, *options = OUTPUTS[suffix]
    line = refused(command, str(saved), *options, "-o", str(tmp_path / "out" / f"x{suffix}"))
    assert "no space left on device" in line
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("suffix", OUTPUTS)
def test_any_name_of_a_file_is_answered(suffix, refused, capsys, saved, tmp_path):
    odd = "\udcff\n"
    saved.rename(tmp_path / f"{odd}.npz")
    command, *options = OUTPUTS[suffix]
    with within_limits():
        out = tmp_path / f"out{odd}{suffix}"
        assert cli.main([command, str(tmp_path / f"{odd}.npz"), *options, "-o", str(out)]) == 0
    assert out.is_file()
    assert capsys.readouterr().out
    for source, target in (("a" * 300, "x"), (odd, "a" * 300)):
        paths = str(tmp_path / f"{source}.npz"), "-o", str(tmp_path / f"{target}{suffix}")
        assert "file name too long" in refused(command, *paths, *options).lower()
