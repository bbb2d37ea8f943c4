"""A corpus without clips, and a study of it."""

import json

import pytest
from tables import kept_runs
from tables.plan import Request

SPLIT = {"clips": 2, "windows": 4, "seconds": 9.0, "words": 5, "speakers": ["ada"], "shards": []}


@pytest.fixture
def corpus(tmp_path):
    folder = tmp_path / "corpus"
    folder.mkdir()
    metadata = {
        "schema_version": 2,
        "name": "made up",
        "source": "a test",
        "skeleton": "ted_expressive",
        "fps": 15,
        "speakers": ["ada"],
        "splits": {"train": SPLIT, "val": SPLIT, "test": SPLIT},
        "statistics": {},
        "words": {},
        "import": {},
    }
    (folder / "dataset.json").write_text(json.dumps(metadata))
    return folder


@pytest.fixture
def request_(tmp_path, corpus):
    return Request("table1", "bvh", "debug", str(corpus), (0, 1), tmp_path / "runs")


@pytest.fixture(autouse=True)
def _no_weights(monkeypatch):
    """Stands for the export of the auto-encoder as a model folder."""

    def export(run, folder):
        (folder / run.name).mkdir(parents=True)
        (folder / run.name / "model.safetensors").write_text("1 2 3")

    monkeypatch.setattr(kept_runs, "_keep_weights", export)
