"""A corpus without clips, and a study of it."""

import json

import pytest
from tables.request import Request

SPLIT = {"clips": 2, "speakers": ["ada"], "shards": []}


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
