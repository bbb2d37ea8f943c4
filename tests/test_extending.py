"""The recipes of docs/extending.md: each applies to the sources as they are, and a package with all of them works."""

import json
import os
import pathlib
import re
import shutil
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "extending.md").read_text()
SECTIONS = {
    title.lower(): text for title, text in re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE)
}
RECIPES = ("a loss term", "an audio encoder", "a method", "a data set", "a metric", "a rig")
FOLDERS = ("ha2g_jax", "experiments")

_DIFF = re.compile(r"^```diff\n--- a/(\S+)\n\+\+\+ b/\1\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_PYTHON = re.compile(r"^```python\n# (\S+\.py)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_JSON = re.compile(r"^`(\S+\.json)`:\n\n```json\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_TRAIN = re.compile(r"^ha2g train --config (\S+) --workdir \S+(.*)$", re.MULTILINE)


def apply(recipe, folder):
    """Write the new files of a recipe and change the others; a hunk's lines must occur once in their file."""
    for path, text in _PYTHON.findall(SECTIONS[recipe]) + _JSON.findall(SECTIONS[recipe]):
        assert not (folder / path).exists(), path
        (folder / path).write_text(text)
    for path, hunks in _DIFF.findall(SECTIONS[recipe]):
        text = (folder / path).read_text()
        for hunk in hunks.split("@@\n")[1:]:
            lines = hunk.splitlines(keepends=True)
            old = "".join(line[1:] or "\n" for line in lines if line[0] != "+")
            new = "".join(line[1:] or "\n" for line in lines if line[0] != "-")
            assert text.count(old) == 1, f"{path} has {text.count(old)} places for:\n{hunk}"
            text = text.replace(old, new)
        (folder / path).write_text(text)


def copy_sources(folder):
    """Copy the sources that recipes change or add to."""
    for name in FOLDERS:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What the checks of `extended_package.py` say of a package with all recipes, by recipe: "" where all is well."""
    folder = tmp_path_factory.mktemp("extended")
    copy_sources(folder)
    for recipe in RECIPES:
        apply(recipe, folder)
    script = ROOT / "tests" / "extended_package.py"
    commands = json.dumps([(config, flags.split()) for config, flags in _TRAIN.findall(PAGE)])
    environment = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script), commands],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_page_has_the_recipes():
    assert tuple(SECTIONS) == RECIPES
    blocks = re.findall(r"^```(?:diff|python|json)$", PAGE, re.MULTILINE)
    assert len(blocks) == sum(len(pattern.findall(PAGE)) for pattern in (_DIFF, _PYTHON, _JSON)) >= 14
    assert len(_TRAIN.findall(PAGE)) == PAGE.count("ha2g train ")


@pytest.mark.parametrize("recipe", RECIPES)
def test_recipe_applies_alone(recipe, tmp_path):
    for path, _ in _DIFF.findall(SECTIONS[recipe]):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / path, tmp_path / path)
    for path, _ in _PYTHON.findall(SECTIONS[recipe]) + _JSON.findall(SECTIONS[recipe]):
        assert not (ROOT / path).exists()
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
    apply(recipe, tmp_path)


@pytest.mark.parametrize("recipe", [*RECIPES, "commands"])
def test_recipe_works(recipe, results):
    assert results[recipe] == ""
