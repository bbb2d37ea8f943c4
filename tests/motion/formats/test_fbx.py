"""Blender writes FBX with the joints where they are; without it one line names the script."""

import os

import numpy as np
import pytest
from fixtures.blender import blender_python
from fixtures.motions import swaying

from ha2g_jax import cli
from ha2g_jax.motion import rigs, solver
from ha2g_jax.motion.armature import world
from ha2g_jax.motion.rigs import retarget

MILLIMETRE = 1e-3


@pytest.mark.parametrize("rig", ["ha2g", "mixamo", "unreal"])
def test_blender_writes_the_joints_where_they_are(tmp_path, monkeypatch, blender, rig):
    program = tmp_path / "bin" / "blender"  # blender --background --python-exit-code 1 --python SCRIPT -- ...
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nshift 4\nexec {blender_python()} "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    motion = swaying(frames=12, size=0.2)
    motion.save(tmp_path / "m.npz")
    assert cli.main(["export", str(tmp_path / "m.npz"), "-o", str(tmp_path / "m.fbx"), "--rig", rig]) == 0
    animation = retarget(solver.animate(motion), rigs.load_rig(rig))
    frames = list(range(12))
    found = blender(tmp_path / "m.fbx", frames)
    _, positions = world(animation)
    for index, name in enumerate(animation.armature.joints):
        np.testing.assert_allclose(found[name], positions[frames, index], atol=MILLIMETRE)


@pytest.mark.parametrize("command", ["export", "generate"])
def test_without_blender_one_line_names_the_script_before_the_work(tmp_path, monkeypatch, capsys, command):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    swaying(frames=12).save(tmp_path / "m.npz")
    assert cli.main([command, str(tmp_path / "m.npz"), "-o", str(tmp_path / "m.fbx")]) == 2
    said = capsys.readouterr().err
    assert "ha2g_blender.py -- MOTION.glb -o MOTION.fbx" in said and said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["m.npz"]
