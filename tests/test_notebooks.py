"""Every notebook runs from top to bottom, and its two halves hold the same cells."""

import ast
import pathlib
import re
import sys
import tomllib

import jupytext
import pytest
from nbclient import NotebookClient

ROOT = pathlib.Path(__file__).parent.parent
NOTEBOOKS = ROOT / "notebooks"
SOURCES = sorted(NOTEBOOKS.glob("*.py"))
# Packages that the options of a program of the Makefile call: `jupytext --execute` calls nbconvert with a kernel.
CALLED = {"jupytext --sync": {"jupytext"}, "jupytext --execute": {"jupytext", "nbconvert", "ipykernel"}}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_notebook_runs(source, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    notebook = jupytext.read(source)
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": NOTEBOOKS}}).execute()


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_pair_is_in_step(source):
    cells = [[cell.source for cell in jupytext.read(path).cells] for path in (source, source.with_suffix(".ipynb"))]
    assert cells[0] == cells[1]


def test_the_extra_of_make_notebooks_names_all_that_it_calls():
    """A fresh clone has nothing but what the extra installs."""
    makefile = (ROOT / "Makefile").read_text()
    rule = re.search(r"^notebooks: \$\(VENV\)/(\w+)\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    assert rule is not None
    installed = re.search(rf"^\$\(VENV\)/{rule[1]}: .*\n\t.* --editable '\.\[([\w,]+)\]'$", makefile, re.MULTILINE)
    assert installed is not None
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [name for extra in installed[1].split(",") for name in project["optional-dependencies"][extra]]
    names = {re.split(r"[\[<>=]", name)[0] for name in [*extras, *project["dependencies"]]}
    commands = re.findall(r"^\t\$\(VENV\)/bin/(\S+ \S+)", rule[2], re.MULTILINE)
    assert set(commands) == set(CALLED)
    assert set().union(*(CALLED[command] for command in commands)) <= names
    imported = {name.split(".")[0] for path in SOURCES for name in _imports(path)}
    assert imported - set(sys.stdlib_module_names) - {"ha2g_jax", "IPython"} <= names  # ipykernel installs IPython


def _imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""
