"""`ha2g doctor` names what is wrong and what to do, changes nothing, and measures a step."""

import json
import types

import pytest

from ha2g_jax import cli
from ha2g_jax.config import presets
from ha2g_jax.train import doctor, measure
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
    monkeypatch.setattr(doctor, "_step", lambda config, corpus: measure.Finding("step", "quick"))


def troubles(findings: list[measure.Finding]) -> dict[str, str]:
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
def a_step(quick_step, tmp_path, tiny_talk):
    """The arguments of a command that finds no trouble, with a step that is not compiled."""
    path = tmp_path / "config.py"
    path.write_text(
        "from ha2g_jax.config import presets\n"
        "def get_config(size):\n"
        "    config = presets.sized('ted_expressive', size)\n"
        f"    config.data.path = {str(tiny_talk)!r}\n"
        "    return config\n"
    )
    return ["doctor", "--config", f"{path}:debug"]


def test_the_command_prints_aligned_lines_or_json_and_its_code_says_whether_all_is_well(a_step, tmp_path, capsys):
    assert cli.main(a_step) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith("ok     ") for line in lines)
    assert len({line.index(line.split(maxsplit=2)[2]) for line in lines}) == 1
    assert cli.main([*a_step, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] and len(report["findings"]) == len(lines)
    path = tmp_path / "config.py"
    path.write_text(path.read_text().replace("config.data.path =", "config.data.path = '/nowhere' +"))
    assert cli.main(a_step) == 1
    wrong = [line for line in capsys.readouterr().out.splitlines() if line.startswith("wrong")]
    assert len(wrong) == 1 and "no corpus in /nowhere" in wrong[0]
    assert cli.main(["doctor", "--config", "missing.py"]) == 2


TROUBLES = {
    "no corpus in a folder": ({"data.path": "/nowhere"}, "data", "no corpus in /nowhere"),
    "no folder": ({"data.path": ""}, "data", "--config.data.path"),
    "another skeleton": ({"skeleton": "ted_gesture"}, "data", "has skeleton ted_expressive"),
    "no word vectors": ({"model.text.vectors": "/nowhere/vectors.txt"}, "words", "vectors.txt"),
    "a batch beyond the data": ({"train.batch_size": 100_000}, "data", "batch of 100000"),
    "an unknown term": ({"train.best_by": "loss/hubber"}, "config", "loss/hubber"),
}


@pytest.mark.usefixtures("quick_step")
@pytest.mark.parametrize(("changes", "name", "trouble"), TROUBLES.values(), ids=TROUBLES)
def test_what_would_stop_a_run_is_named(config, changes, name, trouble):
    config.update_from_flattened_dict(changes)
    assert trouble in troubles(doctor.examine(config))[name]


@pytest.mark.usefixtures("quick_step")
def test_a_damaged_record_is_named(config, monkeypatch):
    from ha2g_jax.data.corpus import Clips
    from ha2g_jax.data.records import unpack

    def last_is_damaged(clips, number):
        return unpack(
            clips.record(number)[:-40] if number == len(clips) - 1 else clips.record(number), f"record {number}"
        )

    monkeypatch.setattr(Clips, "fields", last_is_damaged)
    findings = doctor.examine(config)
    damaged = [finding.found for finding in findings if "damaged" in finding.trouble]
    assert damaged == ["train", "val", "test", "test_unseen_speakers"]


@pytest.mark.usefixtures("quick_step")
def test_talk_is_not_made_for_a_look(config, monkeypatch, tmp_path):
    monkeypatch.setenv("HA2G_CACHE", str(tmp_path))
    config.data.path = "talk"
    findings = doctor.examine(config)
    assert troubles(findings) == {}
    assert any("not made yet" in finding.found for finding in findings)
    assert list(tmp_path.iterdir()) == []


def test_settings_that_cannot_be_used_are_not_measured(config):
    config.train.batch_size = 0
    assert "step" not in {finding.name for finding in doctor.examine(config)}


def test_a_gpu_that_jax_does_not_use_is_named(monkeypatch, tmp_path):
    (tmp_path / "nvidia0").touch()
    monkeypatch.setattr(measure, "_GPU_FILES", (str(tmp_path / "nvidia0"),))
    assert "JAX_PLATFORMS=cpu" in troubles(measure.examine_machine())["devices"]
    monkeypatch.delenv("JAX_PLATFORMS")
    assert "jax[cuda13]" in troubles(measure.examine_machine())["devices"]
    monkeypatch.setattr(measure, "_version", lambda package: "1.0")
    assert "jax-cuda12-plugin does not start" in troubles(measure.examine_machine())["devices"]


def test_the_limit_of_a_container_counts(monkeypatch, tmp_path):
    memory = tmp_path / "meminfo"
    memory.write_text("MemTotal: 2000 kB\nMemFree: 10 kB\nMemAvailable: 1500 kB\n")
    monkeypatch.setattr(measure, "_MEMORY", memory)
    monkeypatch.setattr(measure, "_CONTAINER", tmp_path)
    assert measure.host_memory() == (2000 * 1024, 1500 * 1024)
    (tmp_path / "memory.max").write_text("1000\n")
    (tmp_path / "memory.current").write_text("400\n")
    assert measure.host_memory() == (1000, 600)
    (tmp_path / "memory.max").write_text("max\n")
    assert measure.host_memory() == (2000 * 1024, 1500 * 1024)


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


def test_a_step_is_compiled_and_timed(capsys):
    config = presets.make("ted_gesture", "debug", "seq2seq")  # the least to compile
    values = doctor.examine(config)[-1].values
    assert values is not None
    assert values["windows_per_second"] == pytest.approx(4 / values["step_seconds"])
    memory = values["memory"]
    assert memory["total"] > memory["arguments"] > 1 << 20
    assert memory["aliased"] > 0.9 * memory["outputs"]  # the state is updated in place
    assert "compiling" in capsys.readouterr().err
