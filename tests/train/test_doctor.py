"""`ha2g doctor` names what is wrong and changes nothing; it measures a step, gradients and the sizes of networks."""

import json
import types

import jax
import numpy as np
import pytest

from ha2g_jax import cli
from ha2g_jax.config import presets
from ha2g_jax.config import settings as configs
from ha2g_jax.errors import UserError
from ha2g_jax.train import describe, doctor, gradients, run_record
from ha2g_jax.train.measure import Memory


@pytest.fixture
def config(tiny_talk):
    """The debug size on a corpus that fits it."""
    config = presets.sized("ted_expressive", "debug")
    config.data.path = str(tiny_talk)
    return config


@pytest.fixture
def quick_step(monkeypatch):
    """Compile no step."""
    monkeypatch.setattr(doctor, "_step", lambda config, corpus: doctor.Finding("step", "quick"))


def troubles(findings: list[doctor.Finding]) -> dict[str, str]:
    """Return name -> trouble of the findings that have one."""
    return {finding.name: finding.trouble for finding in findings if finding.trouble}


@pytest.mark.usefixtures("quick_step")
def test_all_is_well_with_a_config_that_fits_its_data(config):
    findings = doctor.examine(config)
    assert troubles(findings) == {}
    values = [finding.values for finding in findings if finding.values]
    splits = {value["split"]: value for value in values if "split" in value}
    assert list(splits) == ["train", "val", "test", "test_unseen_speakers"]
    assert sum(values["hours"] for values in splits.values()) == pytest.approx(2 / 60, rel=0.3)
    assert splits["train"]["windows"] > 0


@pytest.fixture
def config_file(tmp_path, tiny_talk):
    """The path of a config of Seq2Seq, which compiles fastest, on a corpus that fits it."""
    changes = {"data.path": str(tiny_talk)}
    path = tmp_path / "config.py"
    path.write_text(
        "from ha2g_jax.config import presets\n"
        f"def get_config(size=''): return presets.make('talk', 'debug', 'seq2seq', {changes})\n"
    )
    return path


@pytest.mark.usefixtures("quick_step")
def test_the_command_prints_aligned_lines_or_json_and_its_code_says_whether_all_is_well(config_file, tiny_talk, capsys):
    command = ["doctor", "--config", str(config_file)]
    assert cli.main(command) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith("ok     ") for line in lines)
    assert len({line.index(line.split(maxsplit=2)[2]) for line in lines}) == 1
    assert cli.main([*command, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] and len(report["findings"]) == len(lines)
    config_file.write_text(config_file.read_text().replace(str(tiny_talk), "/nowhere"))
    assert cli.main(command) == 1
    wrong = [line for line in capsys.readouterr().out.splitlines() if line.startswith("wrong")]
    assert len(wrong) == 1 and "no corpus in /nowhere" in wrong[0]
    assert cli.main(["doctor", "--config", "missing.py"]) == 2
    assert cli.main(["doctor", "--config", "talk:debug", "--config.data.path=nowhere", "--describe"]) == 0
    assert cli.main(["doctor", "--config", "talk:debug", "--config.data.route=nowhere"]) == 2


TROUBLES = {
    "another skeleton": ({"skeleton": "ted_gesture"}, "data", "has skeleton ted_expressive"),
    "a batch beyond the data": ({"train.batch_size": 100_000}, "data", "batch of 100000"),
    "an unknown term": ({"train.best_by": "loss/hubber"}, "config", "loss/hubber"),
}


@pytest.mark.usefixtures("quick_step")
@pytest.mark.parametrize(("changes", "name", "trouble"), TROUBLES.values(), ids=TROUBLES)
def test_what_would_stop_a_run_is_named(config, changes, name, trouble):
    config.update_from_flattened_dict(changes)
    assert trouble in troubles(doctor.examine(config))[name]


@pytest.mark.usefixtures("quick_step")
def test_talk_is_not_made_for_a_look(config, monkeypatch, tmp_path):
    monkeypatch.setenv("HA2G_CACHE", str(tmp_path))
    config.data.path = "talk"
    findings = doctor.examine(config)
    assert troubles(findings) == {}
    assert any("not made yet" in finding.found for finding in findings)
    assert list(tmp_path.iterdir()) == []


def test_a_gpu_that_jax_does_not_use_is_named(monkeypatch, tmp_path):
    (tmp_path / "nvidia0").touch()
    monkeypatch.setattr(doctor, "_GPU_FILES", (str(tmp_path / "nvidia0"),))
    assert "JAX_PLATFORMS=cpu" in troubles(doctor.examine_machine())["devices"]
    monkeypatch.delenv("JAX_PLATFORMS")
    assert "jax[cuda13]" in troubles(doctor.examine_machine())["devices"]
    monkeypatch.setattr(doctor, "installed", lambda packages: dict.fromkeys(packages, "1.0"))
    assert "jax-cuda12-plugin does not start" in troubles(doctor.examine_machine())["devices"]


def test_the_limit_of_a_container_counts(monkeypatch, tmp_path):
    memory = tmp_path / "meminfo"
    memory.write_text("MemTotal: 2000 kB\nMemFree: 10 kB\nMemAvailable: 1500 kB\n")
    monkeypatch.setattr(run_record, "_MEMORY", memory)
    monkeypatch.setattr(run_record, "_CONTAINER", tmp_path)
    assert run_record.host_memory() == (2000 * 1024, 1500 * 1024)
    (tmp_path / "memory.max").write_text("1000\n")
    (tmp_path / "memory.current").write_text("400\n")
    (tmp_path / "memory.stat").write_text("anon 150\nfile 250\ninactive_file 200\n")
    assert run_record.host_memory() == (1000, 800)  # what was read from files is dropped first
    (tmp_path / "memory.max").write_text("max\n")
    assert run_record.host_memory() == (2000 * 1024, 1500 * 1024)


def test_a_step_that_does_not_fit_is_not_run(config, monkeypatch):
    def never():
        raise AssertionError("it ran")

    step = types.SimpleNamespace(
        compile_seconds=1.0, num_devices=8, batch_size=4, run=never, memory=Memory(2 << 30, 1 << 30, 1 << 30, 1 << 30)
    )
    monkeypatch.setattr(doctor, "TimedStep", lambda *_: step)
    monkeypatch.setattr(doctor, "host_memory", lambda: (64 << 30, 20 << 30))
    finding = doctor.examine(config)[-1]
    assert finding.name == "step"
    assert "needs 24.0 GiB but 20.0 GiB are available" in finding.trouble
    assert "--config.train.batch_size" in finding.trouble


def test_a_step_is_compiled_and_timed():
    config = presets.make("ted_gesture", "debug", "seq2seq")  # the least to compile
    values = doctor.examine(config)[-1].values
    assert values is not None
    assert values["windows_per_second"] == pytest.approx(4 / values["step_seconds"])
    memory = values["memory"]
    assert memory["total"] > memory["arguments"] > 1 << 20
    assert memory["aliased"] > 0.9 * memory["outputs"]  # the state is updated in place


def test_the_terms_and_their_sum_are_those_of_the_step(objective, step, state, batch):
    key = jax.random.key(1)
    after, metrics = step(state, batch, key)
    # A step updates the discriminator before it takes the gradient of the generator.
    found = gradients.term_gradients(objective, state.replace(discriminator=after.discriminator), batch, key)
    names = list(objective.weights._fields)
    terms = [float(metrics[f"loss/{name}"]) for name in (*names, "total")]
    np.testing.assert_allclose(found.value, terms, rtol=1e-4)
    assert found.parameters[-1] == pytest.approx(float(metrics["grad_norm/generator"]), rel=1e-3)
    gan, huber = names.index("gan"), names.index("huber")
    assert found.output[gan] / found.output[huber] == pytest.approx(float(metrics["gradient_ratio/gan"]), rel=1e-3)
    has_output = dict(zip(names, found.output[:-1] > 0, strict=True))
    assert [name for name in names if not has_output[name]] == ["kld", "contrastive", "angle"]
    has_gradient = dict(zip(names, found.parameters[:-1] > 0, strict=True))
    assert [name for name in names if not has_gradient[name]] == ["angle"]  # whose weight is 0


def test_a_source_that_is_not_there_is_refused_before_anything_is_measured(config, monkeypatch):
    monkeypatch.setattr(gradients, "_measure", lambda *_: pytest.fail("measured"))
    with pytest.raises(UserError, match="no model in nowhere"):
        gradients.measure(config, ["nowhere"])


def test_the_command_prints_gradients_as_a_table(config_file, capsys):
    assert cli.main(["doctor", "--gradients", "--config", str(config_file)]) == 0
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert [row[0] for row in rows] == ["| term", "| ---", "| mse", "| continuity", "| variance", "| total"]
    norms = [float(row[3]) for row in rows[2:4]]
    assert rows[2][4] == "1" and float(rows[3][4]) == pytest.approx(norms[1] / norms[0], rel=0.02)


def test_a_description_lists_the_shapes_of_the_paper():
    rows = describe.describe(configs.paper("ted_expressive"))
    outputs = {row["module"]: row["output"] for row in rows}
    audio = {name: outputs[f"generator.audio.{name}"] for name in ("stage_2", "stage_3", "stage_4")}
    assert audio == {"stage_2": "64x64x35", "stage_3": "128x32x18", "stage_4": "256x16x9"}
    assert [outputs[f"generator.audio.{name}"] for name in ("low", "mid", "high")] == ["32x34"] * 3
    widths = (24, 30, 36, 66, 96, 126)
    assert [outputs[f"generator.pose_{level}"] for level in range(1, 7)] == [f"34x{width}" for width in widths]
    assert outputs["generator.coordinator"] == "3x6"
    assert outputs["generator.identity.resnet"] == "512x7x7"
    assert outputs["discriminator.gru"] == "28x64"
    assert outputs["autoencoder.encoder"] == "128"
    stage = next(row for row in rows if row["module"] == "generator.audio.stage_2")
    assert stage["output_shapes"] == [[64, 64, 35]]
    assert stage["input"] == "32x128x70"
    json.dumps(rows)


def test_parts_of_a_description_add_up_and_tables_that_grow_with_data_are_left_out():
    rows = describe.describe(presets.sized("ted_expressive", "debug"))
    counts = {row["module"]: row["parameters"] for row in rows}
    for whole in ("generator", "generator.audio", "generator.pose_1", "discriminator", "autoencoder.encoder"):
        depth = whole.count(".") + 1
        parts = [count for name, count in counts.items() if name.startswith(whole + ".") and name.count(".") == depth]
        assert sum(parts) == counts[whole], whole
    assert "generator.text.embedding" not in counts

    table = describe.as_table(rows).splitlines()
    assert table[0].split() == ["module", "input", "output", "parameters"]
    total = next(line for line in table if line.startswith("total"))
    networks = counts["generator"] + counts["discriminator"] + counts["autoencoder"]
    assert total.split()[-1] == f"{networks:,}"
