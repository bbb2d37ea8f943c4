"""Training works on each kind of data: two steps of the debug size on an imported corpus."""

import pathlib

import pytest

from ha2g_jax import cli
from ha2g_jax.train.workdir import read_metrics

# Command, folder and config. Of the methods Seq2Seq compiles fastest; it trains on the words. Speech2Gesture trains on
# the sound.
SOURCES = {
    "ted_expressive": ("import-ted", "ted_format/expressive", "seq2seq:ted_expressive:debug"),
    "ted_gesture": ("import-ted", "ted_format/gesture", "seq2seq:ted_gesture:debug"),
    "bvh": ("import-bvh", "zeroeggs_067", "speech2gesture:bvh:debug", "--config.model.inferer.layers=1"),
}
# The last level of the motion alone is enough here and half as long to compile.
IMAGES = ("video:debug", "--config.model.inferer.levels=(6,)")


def train_two_steps(data: pathlib.Path, workdir: pathlib.Path, config: str, *changes: str) -> list[dict]:
    """Return the lines of metrics.jsonl."""
    flags = (f"--config={config}", f"--workdir={workdir}", f"--config.data.path={data}", *changes)
    assert cli.main(["train", *flags]) == 0
    return read_metrics(workdir / "metrics.jsonl")


@pytest.mark.parametrize("source", SOURCES)
def test_two_steps_on_recordings(source, private_data, tmp_path):
    command, folder, *config = SOURCES[source]
    assert cli.main(["data", command, str(private_data / folder), str(tmp_path / "corpus")]) == 0
    lines = train_two_steps(tmp_path / "corpus", tmp_path / "run", *config)
    assert max(line["step"] for line in lines) == 2
    # One recording is one talk: nothing is left to validate on.
    assert any("validation/loss/total" in line for line in lines) == (source != "bvh")


def test_two_steps_on_images(tiny_talk, tmp_path):
    """Videos are imported as clips with images of the speakers."""
    lines = train_two_steps(tiny_talk, tmp_path / "run", *IMAGES)
    assert any("validation/loss/huber" in line for line in lines)
