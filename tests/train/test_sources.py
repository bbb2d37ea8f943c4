"""Training works on each kind of data: its config takes two steps on an imported corpus."""

import json
import pathlib
import subprocess
import sys

import pytest

from ha2g_jax import cli

ROOT = pathlib.Path(__file__).parent.parent.parent

# The last level of the motion alone is enough here and half as long to compile.
LAST_LEVEL = "--config.model.inferer.levels=(6,)"
# Command, folder, and the config with its changes. Of the methods Seq2Seq compiles fastest; it trains on the words.
SOURCES = {
    "ted_expressive": ("import-ted", "ted_format/expressive", "seq2seq.py:ted_expressive:debug"),
    "ted_gesture": ("import-ted", "ted_format/gesture", "seq2seq.py:ted_gesture:debug"),
    "bvh": ("import-bvh", "zeroeggs_067", "bvh.py:debug", LAST_LEVEL),
}


def train_two_steps(config: str, data: pathlib.Path, workdir: pathlib.Path, *changes: str) -> list[dict]:
    """Return the lines of metrics.jsonl."""
    flags = (
        f"--config={ROOT}/experiments/configs/{config}",
        f"--workdir={workdir}",
        f"--config.data.path={data}",
        *changes,
    )
    command = [sys.executable, "-m", "ha2g_jax.cli", "train", *flags]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in (workdir / "metrics.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("source", SOURCES)
def test_two_steps_on_recordings(source, private_data, tmp_path):
    command, folder, config, *changes = SOURCES[source]
    assert cli.main(["data", command, str(private_data / folder), str(tmp_path / "corpus")]) == 0
    lines = train_two_steps(config, tmp_path / "corpus", tmp_path / "run", *changes)
    assert max(line["step"] for line in lines) == 2
    # One recording is one talk: nothing is left to validate on.
    assert any("validation/loss/total" in line for line in lines) == (source != "bvh")


def test_two_steps_on_images(tiny_talk, tmp_path):
    """Videos are imported as clips with images of the speakers."""
    lines = train_two_steps("video.py:debug", tiny_talk, tmp_path / "run", LAST_LEVEL)
    assert any("validation/loss/huber" in line for line in lines)
