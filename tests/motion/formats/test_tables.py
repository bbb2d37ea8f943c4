"""JSON and CSV hold the same numbers, which are those of forward kinematics."""

import csv
import json

import numpy as np
import pytest

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import world
from ha2g_jax.motion.formats import tables


@pytest.mark.parametrize("rig", ["ha2g", "unreal"])
def test_json_holds_positions_directions_and_rotations(animate, tmp_path, rig):
    animation = animate(rig=rig)
    tables.write_json(tmp_path / "m.json", animation)
    read = json.loads((tmp_path / "m.json").read_text())
    assert (read["rig"], read["fps"], read["meta"]["seed"]) == (rig, 15.0, 3)
    assert [joint["name"] for joint in read["joints"]] == list(animation.armature.joints)
    frames = read["frames"]
    assert [frame["time"] for frame in frames[:3]] == [0.0, 0.066667, 0.133333]
    _, positions = world(animation)
    np.testing.assert_allclose([frame["positions"] for frame in frames], positions, atol=1e-6)
    np.testing.assert_allclose([frame["rotations"] for frame in frames], animation.rotations, atol=1e-6)
    parents = [joint["parent"] for joint in read["joints"]]
    expected = rotations.unit(positions[:, -1] - positions[:, parents[-1]])
    np.testing.assert_allclose([frame["directions"][-1] for frame in frames], expected, atol=1e-5)


def test_joints_at_their_parents_place_have_no_direction(animate, tmp_path):
    animation = animate()
    tables.write_json(tmp_path / "m.json", animation)
    frame = json.loads((tmp_path / "m.json").read_text())["frames"][3]
    for name in ("spine", "left_clavicle", "left_index_0"):
        assert frame["directions"][animation.armature.joint(name)] == [0, 0, 0]


def test_csv_has_a_named_column_for_every_number_of_the_json(animate, tmp_path):
    animation = animate("ted_gesture")
    tables.write_csv(tmp_path / "m.csv", animation)
    tables.write_json(tmp_path / "m.json", animation)
    frames = json.loads((tmp_path / "m.json").read_text())["frames"]
    with (tmp_path / "m.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(frames)
    assert len(rows[0]) == 2 + 10 * len(animation.armature.joints)
    for row, frame in zip(rows, frames, strict=True):
        index = animation.armature.joint("left_wrist")
        assert float(row["time"]) == frame["time"]
        assert [float(row[f"left_wrist_{axis}"]) for axis in "xyz"] == frame["positions"][index]
        assert [float(row[f"left_wrist_d{axis}"]) for axis in "xyz"] == frame["directions"][index]
        assert [float(row[f"left_wrist_q{axis}"]) for axis in "xyzw"] == frame["rotations"][index]
