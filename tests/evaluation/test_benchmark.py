"""`ha2g doctor --benchmark` measures a step in several precisions and generation, in Markdown or JSON."""

import json
import types
from typing import Any

import jax
import pytest

from ha2g_jax import cli, launch
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.evaluation import benchmark, hours
from ha2g_jax.methods import build

SETTINGS: Any = jax.config

# The step that tests/train/test_doctor.py compiles as well.
COMMAND = ["benchmark", "--config", "seq2seq:ted_gesture:debug", "--steps", "1"]


def test_the_tables_and_the_numbers_agree(monkeypatch, capsys):
    monkeypatch.setattr(benchmark, "_SPEECH_SECONDS", 2)
    monkeypatch.setattr(benchmark, "_CPU_SIZE", 256)
    assert cli.main([*COMMAND, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    (row,) = result["training"]
    assert row["precision"] == "float32" and row["batch_size"] == 4
    assert row["windows_per_second"] == row["batch_size"] / row["step_seconds"]
    assert 0 < row["share"] == row["operations"] / row["step_seconds"] / row["peak"]
    assert result["generation"]["speed"] == 2 / result["generation"]["seconds"]
    text = benchmark.as_tables(result)
    assert f"| float32 | 1 | 4 | {row['compile_seconds']:.1f} | {row['step_seconds']:.4g} |" in text
    assert result["machine"]["devices"] in text


def test_a_precision_changes_the_types_of_the_step(monkeypatch):
    """The bfloat16 row is not the float32 row under another name."""
    found = []

    class Step:
        num_devices, batch_size, compile_seconds, operations = 1, 4, 1.0, 10

        def __init__(self, config):
            found.append((config.train.dtype, SETTINGS.jax_default_matmul_precision))

        def median(self, steps):
            return 0.5

    monkeypatch.setattr(benchmark, "TimedStep", Step)
    monkeypatch.setattr(benchmark, "_measure_generation", lambda _: {"speech_seconds": 2, "seconds": 1.0, "speed": 2.0})
    assert cli.main([*COMMAND, "--precision", *benchmark.PRECISIONS]) == 0
    assert found == [("float32", "float32"), ("float32", "tensorfloat32"), ("bfloat16", "tensorfloat32")]


def test_a_run_is_its_steps_and_the_batches_of_its_validations(tiny_talk, monkeypatch):
    class Step:
        compile_seconds = 7.0

        def __init__(self, config, corpus):
            spec = build(config, corpus.skeleton, len(corpus.vocabulary()), len(corpus.speakers_of("train")))
            self.objective = types.SimpleNamespace(spec=spec)

        def initialise(self):
            return 5.0

        def median(self, steps):
            return 0.5

        def validate(self):
            return 3.0, 0.25

    monkeypatch.setattr(hours, "TimedStep", Step)
    overrides = [f"--config.data.path={tiny_talk}", "--config.train.steps=201", "--config.train.validate_every=50"]
    config = launch.load_config("seq2seq:talk:debug", overrides)
    windows = sum(len(clip.window_starts) for clip in Corpus.open(tiny_talk).clips("val"))
    parts, seconds = hours.predict(config, steps=3)
    assert seconds == 0.5 and parts[:-1] == (5, 7 + 3, 201 * 0.5, 5 * (windows // 4) * 0.25)
    assert 0 < parts.scoring < 300 * 0.1


def test_the_hours_of_table_1_are_steps_times_the_measured_step(monkeypatch, capsys):
    time = hours.RunTime(initialising=36, compiling=72, training=3600, validating=360, scoring=720)
    monkeypatch.setattr(hours, "predict", lambda config, steps: (time, time.training / config.train.steps))
    assert cli.main(["benchmark", "--table1", "ted_gesture:debug"]) == 0
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[1] for row in rows] == [*hours.METHODS, "Table 1"]
    ha2g, total = rows[0], rows[-1]
    assert ha2g[2:] == ["3", "1.8e+03", "0.01", "0.02", "1", "0.1", "0.2", "3.99"]
    assert float(total[-1]) == pytest.approx(5 * 3.99 + 1.33, abs=0.05) and total[2] == "16"
