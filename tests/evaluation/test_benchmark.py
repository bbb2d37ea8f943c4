"""`ha2g doctor --benchmark` measures a step in several precisions and generation, in Markdown or JSON."""

import json
from typing import Any

import jax

from ha2g_jax import cli
from ha2g_jax.evaluation import benchmark

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

        def run(self):
            return 0.5

    monkeypatch.setattr(benchmark, "TimedStep", Step)
    monkeypatch.setattr(benchmark, "_measure_generation", lambda _: {"speech_seconds": 2, "seconds": 1.0, "speed": 2.0})
    assert cli.main([*COMMAND, "--precision", *benchmark.PRECISIONS]) == 0
    assert found == [("float32", "float32"), ("float32", "tensorfloat32"), ("bfloat16", "tensorfloat32")]
