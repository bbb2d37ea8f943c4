"""A trace is complete and readable without more software; without the option there is none."""

import gzip
import json
import pathlib

import jax
import jax.numpy as jnp

from ha2g_jax.train.profiling import Profile


@jax.jit
def work(x: jax.Array) -> jax.Array:
    return jnp.tanh(x @ x)


def run(profile: Profile, steps: int) -> None:
    x = jnp.ones((32, 32))
    for number in range(100, 100 + steps):
        with profile.step(number):
            x = work(x)
    profile.close()


def traces(folder: pathlib.Path) -> list[pathlib.Path]:
    return list(folder.rglob("perfetto_trace.json.gz"))


def traced_steps(path: pathlib.Path) -> list[int]:
    """Return the numbers of the steps in a trace."""
    events = json.loads(gzip.decompress(path.read_bytes()))["traceEvents"]
    return sorted(int(event["args"]["step_num"]) for event in events if event.get("name") == "train")


def test_the_trace_has_the_steps_asked_for_and_says_where_it_is(tmp_path, capsys):
    run(Profile(tmp_path / "profile", first=2, steps=3), 8)
    (path,) = traces(tmp_path)
    assert traced_steps(path) == [102, 103, 104]
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and str(path) in said and "ui.perfetto.dev" in said


def test_a_run_that_ends_early_still_gives_its_trace(tmp_path):
    run(Profile(tmp_path, first=1, steps=5), 3)
    assert traced_steps(traces(tmp_path)[0]) == [101, 102]


def test_a_run_too_short_for_a_trace_says_so(tmp_path, capsys):
    run(Profile(tmp_path, first=3), 2)
    assert traces(tmp_path) == []
    assert "no trace" in capsys.readouterr().err


def test_without_a_folder_nothing_is_done(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(Profile(None), 10)
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr().err == ""
