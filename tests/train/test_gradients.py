"""Norms of the gradients of the terms, compared with what a training step computes, and their table."""

import jax
import numpy as np
import pytest

from ha2g_jax import cli
from ha2g_jax.train import gradients
from ha2g_jax.train.gradients import term_gradients


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
    gradients = [float(row[3]) for row in rows[2:4]]
    assert rows[2][4] == "1" and float(rows[3][4]) == pytest.approx(gradients[1] / gradients[0], rel=0.02)


def test_a_model_that_cannot_be_measured_is_refused(config_file, capsys):
    assert cli.main(["doctor", "--checkpoint", "demo"]) == 2
    assert "--checkpoint" in capsys.readouterr().err
    assert cli.main(["doctor", "--gradients", "--config", config_file, "--checkpoint", "demo"]) == 2
    assert "demo is a model of ha2g, but the config of seq2seq" in capsys.readouterr().err


def test_a_lack_of_memory_is_one_line(config_file, capsys, monkeypatch):
    def fail(*_):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 38419067776 bytes.")

    monkeypatch.setattr(gradients, "term_gradients", fail)
    assert cli.main(["doctor", "--gradients", "--config", config_file]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("ha2g: the gradients fail (RESOURCE_EXHAUSTED") and error.endswith("a smaller batch")
