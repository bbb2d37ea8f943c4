"""An ONNX file generates the motion of the model that it was exported from, without JAX."""

import importlib.metadata
import json
import pathlib
import re
import shutil
import subprocess
import sys
import tomllib

import numpy as np
import pytest
import soundfile

from ha2g_jax.apps import generate
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.errors import UserError
from ha2g_jax.motion import control
from ha2g_jax.motion.motion import Motion
from ha2g_jax.synthesis import Style, load_onnx
from ha2g_jax.synthesis.onnx_model import exported

ROOT = pathlib.Path(__file__).parents[2]


@pytest.fixture(scope="module")
def onnx_model(debug_onnx):
    return load_onnx(debug_onnx)


def speech(seconds):
    return np.asarray(np.random.default_rng(0).normal(0, 0.1, round(seconds * 16000)), np.float32)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"style": Style(speaker="ben"), "fps": 30.0, "seed": 3},
        {"style": Style(mixture={"ada": 1, "ben": 3}), "smoothing": 0.3},
        {"controls": control.Controls(energy=0.5, mirror=True), "style": Style(values=np.zeros(18))},
    ],
)
def test_motion_is_that_of_the_model(debug_model, onnx_model, options):
    """Joins, controls and metadata included; 7 seconds have four windows."""
    expected, found = (model.generate(speech(7), **options) for model in (debug_model, onnx_model))
    np.testing.assert_allclose(found.directions, expected.directions, atol=1e-4)
    assert found.meta | {"checkpoint": ""} == expected.meta | {"checkpoint": ""}
    again = onnx_model.generate(speech(7), **options)
    np.testing.assert_array_equal(again.directions, found.directions)


def test_takes_are_those_of_the_model_that_samples(sampling_model, sampling_onnx):
    onnx_model, options = load_onnx(sampling_onnx), {"style": Style(values=np.zeros(18)), "seed": 4}
    expected, found = (model.generate(speech(7), **options) for model in (sampling_model, onnx_model))
    np.testing.assert_allclose(found.directions, expected.directions, atol=1e-4)


def test_a_motion_is_continued(debug_model, onnx_model):
    first = onnx_model.generate(speech(3))
    expected, found = (model.generate(speech(5), seed_pose=first) for model in (debug_model, onnx_model))
    np.testing.assert_allclose(found.directions, expected.directions, atol=1e-4)


def test_reference_images_need_the_whole_model(onnx_model, tmp_path):
    with pytest.raises(UserError, match="knows speakers by name, not by images; expected one of: ada, ben"):
        onnx_model.generate(speech(1), style=Style(images=tmp_path / "a.png"))


def test_function_and_command_generate_with_the_packages_of_the_page_alone(onnx_model, debug_onnx, tmp_path):
    """In a process of its own, where the other packages of the base install cannot be imported."""
    page = (ROOT / "docs" / "onnx.md").read_text()
    first, more = re.findall(r"^pip install (numpy .*?|scipy .*?)(?: *#.*)?$", page, re.MULTILINE)
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    others = {line.partition(">")[0] for line in needed} - {*first.split(), *more.split()}
    assert {"jax", "flax", "librosa"} <= others
    modules = importlib.metadata.packages_distributions()
    blocked = [module for module, packages in modules.items() if others & {name.lower() for name in packages}]
    soundfile.write(tmp_path / "a.wav", speech(2.5), 16000)
    code = (
        "import sys; blocked, speech, model, *outs = sys.argv[1:]\n"
        "sys.modules.update(dict.fromkeys(blocked.split()))\n"
        "from ha2g_jax import cli, synthesis\n"
        "from ha2g_jax.motion import formats\n"
        "motion = synthesis.load_onnx(model).generate(speech)\n"
        "for out in outs[:-1]: formats.export(motion, out)\n"
        "sys.exit(cli.main(['generate', speech, '--checkpoint', model, '-o', outs[-1]]))"
    )
    outs = [tmp_path / f"a.{suffix}" for suffix in ("npz", "bvh", "glb", "html")]
    command = [sys.executable, "-c", code, " ".join(blocked), tmp_path / "a.wav", debug_onnx, *outs]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0 and all(out.is_file() for out in outs), result.stderr
    expected = onnx_model.generate(tmp_path / "a.wav")
    np.testing.assert_array_equal(Motion.load(outs[0]).directions, expected.directions)


def test_a_model_folder_is_exported_to_the_cache_once(debug_folder, tmp_path, monkeypatch):
    monkeypatch.setenv("HA2G_CACHE", str(tmp_path))
    first = exported(debug_folder)
    assert first.parent == tmp_path / "onnx" and first.name.startswith(model_folder.load(debug_folder).assets.hash)
    written = first.stat().st_mtime_ns
    assert generate.load(debug_folder, "onnx").assets.hash == model_folder.load(debug_folder).assets.hash
    assert exported(debug_folder).stat().st_mtime_ns == written


def test_a_model_folder_with_other_assets_is_exported_again(debug_folder, tmp_path, monkeypatch):
    monkeypatch.setenv("HA2G_CACHE", str(tmp_path / "cache"))
    changed = pathlib.Path(shutil.copytree(debug_folder, tmp_path / "changed"))
    assets = json.loads((changed / "assets.json").read_text())
    (changed / "assets.json").write_text(json.dumps(assets, indent=1))
    assert exported(debug_folder) != exported(changed)
