"""Norms of the gradients of the terms, compared with what a training step computes, and their table."""

import jax
import numpy as np
import pytest

from ha2g_jax import cli
from ha2g_jax.train import gradients
from ha2g_jax.train.gradients import as_table, term_gradients


def test_the_terms_and_their_sum_are_those_of_the_step(objective, step, state, batch):
    key = jax.random.key(1)
    after, metrics = step(state, batch, key)
    # A step updates the discriminator before it takes the gradient of the generator.
    found = term_gradients(objective, state.replace(discriminator=after.discriminator), batch, key)
    names = list(objective.weights._fields)
    terms = [float(metrics[f"loss/{name}"]) for name in (*names, "total")]
    np.testing.assert_allclose(found.value, terms, rtol=1e-4)
    assert found.parameters[-1] == pytest.approx(float(metrics["grad_norm/generator"]), rel=1e-3)
    gan, huber = names.index("gan"), names.index("huber")
    assert found.output[gan] / found.output[huber] == pytest.approx(float(metrics["gradient_ratio/gan"]), rel=1e-3)
    has_output = dict(zip(names, found.output[:-1] > 0, strict=True))
    assert [name for name in names if not has_output[name]] == ["kld", "contrastive"]
    assert (found.parameters > 0).all()


RESULT = {
    "config": "ha2g",
    "batch_size": 32,
    "reconstruction": "huber",
    "rigid_pairs": 14,
    "pairs": 41,
    "terms": [
        {"name": "huber", "weight": 200.0},
        {"name": "physical", "weight": 0.1},
        {"name": "total", "weight": 1.0},
    ],
    "models": [{"name": "new", "value": [0.5, -3, 99.7], "parameters": [80, 4, 82], "output": [0.5, 0.1, 0.6]}],
}


def test_a_row_compares_a_term_with_the_reconstruction():
    lines = as_table(RESULT).splitlines()
    assert lines[0] == "| term | weight | new: value | gradient | of huber's | at the output |"
    assert lines[3] == "| physical | 0.1 | -3 | 4 | 0.05 | 0.1 |"
    assert lines[-1] == "14 of 41 angles are rigid; the physical term leaves them out."


@pytest.fixture
def config_file(tiny_talk, tmp_path):
    path = tmp_path / "config.py"
    path.write_text(
        f"""from ha2g_jax.config import presets
def get_config(size=""):
    return presets.make("talk", "debug", "seq2seq", {{"data.path": {str(tiny_talk)!r}}})
"""
    )
    return str(path)


def test_the_command_prints_a_table(config_file, capsys):
    assert cli.main(["doctor", "--gradients", "--config", config_file]) == 0
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert [row[0] for row in rows] == ["| term", "| ---", "| mse", "| continuity", "| variance", "| total"]
    assert rows[2][4] == "1" and float(rows[3][3]) > 0


def test_a_model_without_something_to_measure_on_it_is_refused(capsys):
    assert cli.main(["doctor", "--checkpoint", "demo"]) == 2
    assert "--checkpoint" in capsys.readouterr().err


def test_a_source_of_another_method_is_refused(config_file, capsys):
    assert cli.main(["doctor", "--gradients", "--config", config_file, "--checkpoint", "demo"]) == 2
    assert "demo is a model of ha2g, but the config of seq2seq" in capsys.readouterr().err


def test_a_lack_of_memory_is_one_line(config_file, capsys, monkeypatch):
    def fail(*_):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 38419067776 bytes.")

    monkeypatch.setattr(gradients, "term_gradients", fail)
    assert cli.main(["doctor", "--gradients", "--config", config_file]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("ha2g: the gradients fail (RESOURCE_EXHAUSTED") and error.endswith("a smaller batch")
