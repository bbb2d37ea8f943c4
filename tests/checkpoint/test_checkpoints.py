"""A checkpoint is restored exactly; damage is found, named and skipped; a full disk loses no checkpoint."""

import contextlib
import ctypes
import pathlib
import shutil
import subprocess
import sys
import textwrap
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh, NamedSharding, PartitionSpec, SingleDeviceSharding

from ha2g_jax.checkpoint import CHECKSUMS
from ha2g_jax.checkpoint.checkpoints import Checkpoints
from ha2g_jax.checkpoint.state import Network, TrainState
from ha2g_jax.errors import UserError

RECORD = {"batches": 7, "log": {"sums": [0.1, 1e-9]}, "speakers": {"ada": [0.5]}}


def _state(value: float, size: int = 6, average: bool = False) -> TrainState:
    def network(seed: int) -> Network:
        weights = jax.random.normal(jax.random.key(seed), (size,)) + value
        return Network(
            params={"w": weights}, batch_stats={}, opt_state=(jnp.int32(1), None, {"b": jnp.bfloat16(value)})
        )

    variables = {"params": {"w": jnp.full(size, value)}, "batch_stats": {}} if average else None
    return TrainState(jnp.int32(5), network(0), network(1), average=variables, is_finite=jnp.bool_(True))


def _restore(folder: pathlib.Path, like: TrainState, sharding: Any = None) -> tuple[TrainState, Any]:
    """Return the newest state, by default on one device, and its record."""
    sharding = sharding or SingleDeviceSharding(jax.devices()[0])
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), like)
    found = Checkpoints(folder).restore_newest(shapes)
    assert found is not None
    return found


def _assert_equal(found: TrainState, expected: TrainState) -> None:
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A folder with checkpoints 2 and 3, which tests must not change."""
    folder = tmp_path_factory.mktemp("run") / "latest"
    with contextlib.closing(Checkpoints(folder, keep=2)) as checkpoints:
        for step in (1, 2, 3):
            checkpoints.save(step, _state(step / 3), RECORD | {"batches": step})
    return folder


@pytest.fixture
def folder(saved, tmp_path):
    """A copy of `saved` that a test may damage."""
    return shutil.copytree(saved, tmp_path / "latest")


def _files(folder: pathlib.Path) -> list[pathlib.Path]:
    """Return the files with the saved arrays or with checksums."""
    return sorted(
        path for path in folder.rglob("*") if (path.is_file() and path.parent != folder) or path.name == CHECKSUMS
    )


def test_state_and_record_come_back(saved):
    state, record = _restore(saved, _state(0.0))
    _assert_equal(state, _state(1.0))
    assert record == RECORD | {"batches": 3}
    variables, record = Checkpoints(saved).restore_model(2, _state(0.0).generator.variables)
    np.testing.assert_array_equal(variables["params"]["w"], _state(2 / 3).generator.params["w"])
    assert record["batches"] == 2


def test_a_state_with_an_average_comes_back_and_nothing_is_printed(tmp_path, capfd):
    with contextlib.closing(Checkpoints(tmp_path / "latest")) as checkpoints:
        checkpoints.save(1, _state(0.3, average=True), {})
        checkpoints.check()
        checkpoints.wait()
        _assert_equal(_restore(tmp_path / "latest", _state(0.0, average=True))[0], _state(0.3, average=True))
    assert capfd.readouterr() == ("", "")


def test_the_last_ones_are_kept_and_none_is_written_twice(folder):
    with contextlib.closing(Checkpoints(folder, keep=2)) as checkpoints:
        assert checkpoints.steps() == [2, 3]
        checkpoints.save(3, _state(9.0), {})
        assert _restore(folder, _state(0.0))[1]["batches"] == 3
        checkpoints.save(4, _state(9.0), {})
    assert sorted(path.name for path in folder.iterdir()) == ["3", "4"]


def test_what_is_later_than_the_step_from_which_a_run_goes_on_is_written_again(folder):
    with contextlib.closing(Checkpoints(folder, keep=2)) as checkpoints:
        checkpoints.drop_after(2)
        assert checkpoints.steps() == [2]
        checkpoints.save(3, _state(9.0), {"batches": 9})
    assert _restore(folder, _state(0.0))[1]["batches"] == 9


def test_what_is_given_up_after_save_is_not_what_is_written(tmp_path):
    random = np.random.default_rng(0)
    many = {str(number): jnp.asarray(random.standard_normal(1_000_000, np.float32)) for number in range(10)}
    state = jax.tree.map(jnp.copy, _state(0.0).replace(average=many))
    expected = jax.tree.map(np.array, state)  # copies
    record = {"names": ["ada"]}
    with contextlib.closing(Checkpoints(tmp_path / "latest")) as checkpoints:
        checkpoints.save(1, state, record)
        record["names"].append("ben")
        for leaf in jax.tree.leaves(state):  # as a step does that is given the memory
            ctypes.memset(leaf.unsafe_buffer_pointer(), 0x55, leaf.nbytes)
        assert np.asarray(state.step) == 0x55555555
        checkpoints.wait()
        found, record = _restore(tmp_path / "latest", state)
        _assert_equal(jax.tree.map(np.asarray, found), expected)
        assert record == {"names": ["ada"]}


def test_a_state_moves_between_one_device_and_eight(tmp_path):
    mesh = Mesh(np.array(jax.devices()), ("data",))
    many, one = NamedSharding(mesh, PartitionSpec()), SingleDeviceSharding(jax.devices()[0])
    assert mesh.size == 8
    for number, (source, target) in enumerate(((many, one), (one, many))):
        state = jax.device_put(_state(0.7), source)
        with contextlib.closing(Checkpoints(tmp_path / str(number))) as checkpoints:
            checkpoints.save(1, state, {})
        found, _ = _restore(tmp_path / str(number), state, target)
        _assert_equal(found, state)
        assert all(leaf.sharding == target for leaf in jax.tree.leaves(found))


def test_another_model_is_refused_and_not_taken_for_damage(saved, capfd):
    network = Network(params={"v": jnp.zeros(4)}, batch_stats={}, opt_state=())
    others = {
        r"generator/opt_state/0 is int32\[\] there, not here": _state(0.0).replace(generator=network),
        r"discriminator/params/w is float32\[6\] there, float32\[7\] here": _state(0.0, size=7),
        r"average/params/w is not there, float32\[6\] here": _state(0.0, average=True),
    }
    for message, other in others.items():
        with pytest.raises(UserError, match=rf"latest/3 is of another model \({message}\)"):
            _restore(saved, other)
    assert not capfd.readouterr().err


def _truncate(path):
    path.write_bytes(path.read_bytes()[:-1])


def _flip(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def _double(path):
    path.with_name("other").write_bytes(path.read_bytes())


@pytest.mark.parametrize("damage", [_truncate, _flip, pathlib.Path.unlink, _double])
def test_damage_of_any_file_is_found(folder, damage):
    names = [path.relative_to(folder / "3") for path in _files(folder / "3")]
    assert len(names) > 8
    for name in names:
        if damage is _double and name.name == CHECKSUMS:
            continue
        copy = shutil.copytree(folder, folder.parent / "copy" / name / "latest")
        damage(copy / "3" / name)
        with pytest.raises(UserError, match=r"checkpoint .*latest/3 is damaged \(.*\); use .*latest/2"):
            Checkpoints(copy).restore_model(3, _state(0.0).generator.variables)


def test_the_one_before_a_damaged_one_is_used_and_the_damaged_one_can_be_written_again(folder, capfd):
    _flip(next((folder / "3" / "state" / "d").iterdir()))
    with contextlib.closing(Checkpoints(folder, keep=2)) as checkpoints:
        state, record = _restore(folder, _state(0.0))
        assert record["batches"] == 2
        _assert_equal(state, _state(2 / 3))
        (line,) = capfd.readouterr().err.splitlines()
        assert f"checkpoint {folder}/3 is damaged (state/d/" in line
        assert line.endswith(f"and was renamed to 3.damaged; using {folder}/2")
        checkpoints.save(3, _state(1.0), {"batches": 33})
    assert sorted(path.name for path in folder.iterdir()) == ["2", "3", "3.damaged"]
    assert _restore(folder, _state(0.0))[1] == {"batches": 33}


def test_where_all_are_damaged_the_run_does_not_start_anew(folder):
    for step in (2, 3):
        _truncate(folder / str(step) / CHECKSUMS)
    with pytest.raises(UserError, match=r"all checkpoints in .*latest are damaged \(2: .*, 3: .*\)"):
        _restore(folder, _state(0.0))
    assert sorted(path.name for path in folder.iterdir()) == ["2", "3"]
    assert Checkpoints(folder.parent / "none").restore_newest(_state(0.0)) is None


def test_what_a_killed_run_left_does_not_count_and_goes_away(folder):
    left = shutil.copytree(folder / "3", folder / "4.orbax-checkpoint-tmp")
    (left / CHECKSUMS).unlink()
    checkpoints = Checkpoints(folder, keep=2)
    assert checkpoints.steps() == [2, 3]
    assert left.exists()  # a reader leaves what a run may be writing
    checkpoints.save(5, _state(0.0), {})
    checkpoints.close()
    assert sorted(path.name for path in folder.iterdir()) == ["3", "5"]


def test_a_full_disk_is_named_and_leaves_the_checkpoints_that_are_there(tmp_path):
    """The limit on the size of a file stands for the full disk: both fail in the middle of a write."""
    code = f"""
        import resource, signal, sys
        sys.path.insert(0, {str(pathlib.Path(__file__).parent)!r})
        from ha2g_jax.errors import UserError
        from ha2g_jax.checkpoint.checkpoints import Checkpoints
        from test_checkpoints import *
        from test_checkpoints import _state
        import pathlib

        checkpoints = Checkpoints(pathlib.Path(sys.argv[1]), keep=1)
        checkpoints.save(1, _state(0.0), RECORD)
        checkpoints.wait()
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
        for call in (checkpoints.wait, lambda: checkpoints.save(3, _state(0.0), RECORD), checkpoints.close):
            try:
                checkpoints.save(2, _state(0.0, size=1_000_000), RECORD)
                call()
            except UserError as error:
                print(error)
        checkpoints.close()
    """
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(code), tmp_path / "latest"],
        capture_output=True,
        text=True,
        check=True,
    )
    lines = result.stdout.splitlines()
    assert len(lines) == 3
    for line in lines:
        assert line.startswith(f"cannot write checkpoint {tmp_path}/latest/2 (File too large; it needs 8.0 MB, ")
        assert line.endswith("latest/1 is complete: free some space, then the same command continues")
    assert not result.stderr
    assert Checkpoints(tmp_path / "latest").steps() == [1] and _restore(tmp_path / "latest", _state(0.0))[1] == RECORD
