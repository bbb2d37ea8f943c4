"""Workdirs with damaged files are loaded or refused in one line; a full disk leaves nothing that looks complete."""

import gc
import json
import pathlib
import shutil
import subprocess
import sys
import textwrap

import jax.numpy as jnp
import pytest
from fuzz.mutation import FUZZ, damaged_tree
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax import launch
from ha2g_jax.checkpoint import loading, model_folder
from ha2g_jax.checkpoint.checkpoints import Checkpoints
from ha2g_jax.checkpoint.orbax_format import CHECKSUMS
from ha2g_jax.checkpoint.state import Network, TrainState
from ha2g_jax.errors import UserError
from ha2g_jax.methods.build import variable_shapes
from ha2g_jax.synthesis.files import generate_files
from ha2g_jax.train import fits
from ha2g_jax.train.workdir import read_metrics

# Orbax reads arrays at once in tasks of asyncio, and leaves those behind that fail after the first.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

FEW = settings(FUZZ, max_examples=max(8, FUZZ.max_examples // 5))  # reading with Orbax takes a third of a second


@pytest.fixture(autouse=True)
def no_task_is_left():
    """Collect such tasks here, where their warnings are expected, and not during a later test."""
    yield
    gc.collect()


@pytest.fixture(scope="module")
def run(debug_model, tmp_path_factory):
    """The workdir of a run with one checkpoint, whose networks are traced once."""
    workdir = tmp_path_factory.mktemp("runs") / "debug"
    workdir.mkdir()
    model_folder.write_description(workdir, debug_model.config, debug_model.assets)
    generator = Network(opt_state=(), **debug_model.variables)
    state = TrainState(jnp.int32(7), generator, None, average=None, is_finite=jnp.bool_(True))
    styles = {name: f_id.tolist() for name, f_id in debug_model.assets.speakers.items()}
    checkpoints = Checkpoints(workdir / "best")
    checkpoints.save(7, state, {"speakers": styles})
    checkpoints.close()
    shapes = variable_shapes(debug_model.spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(model_folder, "variable_shapes", lambda _: shapes)
        assert loading.load(workdir).assets.speakers.keys() == {"ada", "ben"}
        yield workdir


def files_of(workdir: pathlib.Path) -> list[str]:
    return sorted(path.relative_to(workdir).as_posix() for path in workdir.rglob("*") if path.is_file())


@pytest.mark.parametrize("damage", ["removed", "cut", "emptied"])
def test_every_file_of_a_checkpoint_is_checked(run, tmp_path, damage):
    for name in files_of(run / "best" / "7"):
        if "/" not in name and name != CHECKSUMS:
            continue  # Orbax's notes for itself
        workdir = shutil.copytree(run, tmp_path / name.replace("/", "_"))
        path = workdir / "best" / "7" / name
        content = path.read_bytes()
        if damage == "removed":
            path.unlink()
        else:
            path.write_bytes(content[: len(content) // 2] if damage == "cut" else b"")
        if content or damage == "removed":
            with pytest.raises(UserError, match=r"checkpoint .* is damaged \(.*; put back a good copy"):
                loading.load(workdir)


@FUZZ
@given(data=st.data())
def test_configs_of_workdirs(answered, run, tmp_path, data):
    config = launch.load_config("tests/one_stage.py:debug")
    values = data.draw(damaged_tree(model_folder.config_to_json(config)))
    answered(lambda path: fits.check_workdir(path.parent, config), json.dumps(values).encode(), "config.json")


def test_a_number_of_400_digits_in_the_config_of_a_run_is_refused(answered):
    config = launch.load_config("tests/one_stage.py:debug")
    values = model_folder.config_to_json(config)
    values["data"]["mirror"] = 10**400
    answered(lambda path: fits.check_workdir(path.parent, config), json.dumps(values).encode(), "config.json")


NAMES = ["x" * 300, "na\udcffme", "two\nlines"]


@pytest.mark.parametrize("name", NAMES)
def test_any_path_is_named_in_one_line(refused, tmp_path, name):
    shown = "x..." if name[0] == "x" else name.encode(errors="surrogateescape").decode(errors="backslashreplace")
    shown = shown.replace("\n", "\\n")
    (tmp_path / "file").touch()
    for command in (
        ["export-model", f"{tmp_path}/{name}/run", f"{tmp_path}/out"],
        ["describe", "--config", f"{tmp_path}/{name}:debug"],
        ["train", "--config", f"{tmp_path}/{name}", "--workdir", f"{tmp_path}/run"],
        ["train", "--config", "tests/one_stage.py:debug", "--workdir", f"{tmp_path}/file/{name}"],
        ["generate", f"{tmp_path}/speech.wav", "--words", f"{tmp_path}/{name}"],
    ):
        assert shown[:4] in refused(*command) or "x" * 40 in refused(*command)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_code_of_a_config_may_fail(refused, tmp_path):
    for number, code in enumerate(
        ["1 / 0", "def get_config(size): return size.x", "\0", "(" * 10_000, "def f(", "raise Exception"]
    ):
        path = tmp_path / f"config_{number}.py"
        path.write_text(code)
        assert path.name in refused("describe", "--config", f"{path}:debug")


def test_a_transcript_that_is_missing_is_refused_before_the_work(tmp_path):
    with pytest.raises(UserError, match=r"cannot read .*words\.txt \(No such file or directory\)"):
        generate_files(tmp_path / "speech.wav", words=tmp_path / "words.txt")


def test_a_full_disk_leaves_no_part_of_a_model_or_a_run(tmp_path):
    """The limit on the size of a file stands for the full disk: both fail in the middle of a write."""
    code = """
        import pathlib, resource, sys
        sys.path.insert(0, "tests")
        import conftest
        from ha2g_jax.checkpoint import loading, model_folder
        from ha2g_jax.errors import UserError
        from ha2g_jax.train import fits, run_record, workdir

        folder = pathlib.Path(sys.argv[1])
        model = loading.load("demo")
        metrics = folder / "metrics.jsonl"
        for step in range(100):
            workdir.append_metrics(metrics, step, {"loss/huber": 0.5})
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))
        steps = (
            lambda: model_folder.save(folder / "model", model.config, model.assets, model.variables),
            lambda: model_folder.write_description(folder, model.config, model.assets),
            lambda: [workdir.append_metrics(metrics, step, {"loss/huber": 0.5}) for step in range(100, 200)],
            lambda: workdir.start_metrics(metrics, 1000),
            lambda: run_record._write(folder, {"starts": ["x" * 4000]}),
        )
        for step in steps:
            try:
                step()
            except UserError as error:
                print(error)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), tmp_path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 5 and all("ile too large" in line for line in lines), lines
    assert sorted(path.name for path in tmp_path.iterdir()) == ["config.json", "metrics.jsonl"]
    assert json.loads((tmp_path / "config.json").read_text())["method"] == "ha2g"
    assert [line["step"] for line in read_metrics(tmp_path / "metrics.jsonl")][:100] == list(range(100))
