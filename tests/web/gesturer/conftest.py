"""A page's Gesturer, in Node with its worker in the same process."""

import json
import pathlib
import shutil
import subprocess

import pytest

from ha2g_jax.synthesis.backends import exported
from ha2g_jax.synthesis.takes import page_description

ROOT = pathlib.Path(__file__).parents[3]
MODULES = ROOT / "web" / "node_modules"


@pytest.fixture(scope="session")
def page_program(tmp_path_factory):
    """The command that does jobs with a Gesturer, see gesturer.ts."""
    node, esbuild = shutil.which("node"), MODULES / ".bin" / "esbuild"
    if not node or not esbuild.exists():
        pytest.skip("needs node and the modules of web/ (npm ci --prefix web)")
    path = tmp_path_factory.mktemp("page") / "gesturer.mjs"
    source = pathlib.Path(__file__).with_name("gesturer.ts")
    options = ("--bundle", "--format=esm", "--platform=node", "--log-level=warning", f"--outfile={path}")
    subprocess.run([esbuild, source, *options], check=True)
    return [node, path]


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
