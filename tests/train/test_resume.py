"""A run in its own process that is killed or asked to stop continues as if it had not been stopped."""

import json
import os
import pathlib
import shutil
import signal
import time

import pytest
import soak_resume as soak

ENDLESS = 1_000_000  # steps
# The method that starts fastest; tests/train/test_loop.py resumes Trimodal with its discriminator.
CONFIG = "seq2seq:talk:debug"


@pytest.fixture(scope="module", params=[1, 3])
def soaked(tiny_talk, tmp_path_factory, request):
    """A folder with the runs "whole" and "broken", the second killed so often, and their differences."""
    folder = tmp_path_factory.mktemp("soak")
    return folder, soak.soak(tiny_talk, folder, kills=request.param, steps=25, config=CONFIG)


def test_a_run_that_is_killed_ends_as_one_left_alone(soaked):
    assert soaked[1] == []


def test_the_soak_notices_what_differs(soaked, tmp_path):
    whole = soaked[0] / "whole"
    other = shutil.copytree(whole, tmp_path / "other")
    shutil.rmtree(other / "latest" / "25")
    assert soak.differences(whole, other) == ["the last checkpoint is of step 20 instead of 25"]
    (other / "latest" / "20").rename(other / "latest" / "25")
    metrics = other / "metrics.jsonl"
    metrics.write_text(metrics.read_text().replace('"loss/mse": 0.', '"loss/mse": 1.', 1))
    problems = soak.differences(whole, other)
    for part in ("'params'", "'batch_stats'", "'opt_state'", "log of the record", "step 3: loss/mse differs"):
        assert any(part in problem for problem in problems)


def test_sigterm_ends_a_run_in_time_with_a_checkpoint(tiny_talk, tmp_path):
    workdir, log = tmp_path / "run", tmp_path / "log"
    with soak.training(soak.command(tiny_talk, workdir, ENDLESS, config=CONFIG), log) as run:
        soak.until(lambda: len(soak.lines(workdir)) > 1, run)
        run.send_signal(signal.SIGTERM)
        assert run.wait(timeout=30) == 0, log.read_text()
    (step,) = {int(path.name) for path in (workdir / "latest").iterdir()} - {soak.CHECKPOINT_EVERY}
    assert f"stopped at step {step} of {ENDLESS}; the same command continues" in log.read_text()
    assert (workdir / "latest" / str(step) / "SHA256SUMS").exists()
    assert json.loads((workdir / "latest" / str(step) / "record" / "metadata").read_text())["log"]
    assert step - soak.LOG_EVERY < soak.lines(workdir)[-1]["step"] <= step


def test_sigterm_while_the_first_step_is_compiled_ends_a_run_in_time(tiny_talk, tmp_path):
    workdir, log, cache = tmp_path / "run", tmp_path / "log", tmp_path / "cache"
    cache.mkdir()
    for path in pathlib.Path(os.environ["JAX_COMPILATION_CACHE_DIR"]).glob("jit_init_state-*"):  # all but the step
        shutil.copy(path, cache)
    with soak.training(soak.command(tiny_talk, workdir, ENDLESS), log, JAX_COMPILATION_CACHE_DIR=str(cache)) as run:
        soak.until(lambda: (workdir / "metrics.jsonl").exists(), run)
        time.sleep(2.0)  # the compiler is at work by then, and takes longer than that
        assert not soak.lines(workdir)
        run.send_signal(signal.SIGTERM)
        assert run.wait(timeout=30) == 0, log.read_text()
    assert not soak.lines(workdir)
    assert "Traceback" not in log.read_text()
