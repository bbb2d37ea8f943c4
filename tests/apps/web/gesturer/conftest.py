"""A page's Gesturer, in Node with its worker in the same process."""

import json
import pathlib
import shutil
import subprocess

import pytest
from fixtures.bundles import bundle

from ha2g_jax.synthesis.onnx_model import exported, page_description

ROOT = pathlib.Path(__file__).parents[4]
MODULES = ROOT / "integrations" / "web" / "node_modules"


@pytest.fixture(scope="session")
def page_program(tmp_path_factory):
    """The command that does jobs with a Gesturer, see gesturer.ts."""
    return bundle(pathlib.Path(__file__).with_name("gesturer.ts"), tmp_path_factory.mktemp("page"))


@pytest.fixture(scope="session")
def demo_folder(tmp_path_factory):
    """A folder with model.onnx and model.json of the demo."""
    folder = tmp_path_factory.mktemp("demo")
    path = pathlib.Path(shutil.copy(exported("demo"), folder / "model.onnx"))
    path.with_suffix(".json").write_text(json.dumps(page_description(path)))
    return folder


@pytest.fixture(scope="session")
def do_jobs(page_program, tmp_path_factory):
    """A function from the folder of a model and jobs to what `Gesturer` found, in the same order."""
    wasm = MODULES / "onnxruntime-web" / "dist" / "ort-wasm-simd-threaded.wasm"

    def do(folder, jobs):
        path = tmp_path_factory.mktemp("jobs") / "jobs.json"
        path.write_text(json.dumps(jobs, default=str))
        done = subprocess.run(
            [*page_program, folder, wasm, path], capture_output=True, text=True, check=False, timeout=300
        )
        assert done.returncode == 0, done.stderr
        answer = json.loads(done.stdout)
        assert answer["loading"][-1] == 1
        assert answer["loading"] == sorted(answer["loading"])
        return answer["found"]

    return do
