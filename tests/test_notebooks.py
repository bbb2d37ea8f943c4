"""Every notebook runs from top to bottom, its two halves hold the same cells, and what it stores is fit to be shown."""

import ast
import importlib.util
import pathlib
import re
import sys
import tomllib

import pytest

ROOT = pathlib.Path(__file__).parent.parent
NOTEBOOKS = ROOT / "notebooks"
SOURCES = sorted(NOTEBOOKS.glob("[0-9]*.py"))
MAX_BYTES = 3 << 20  # of all notebooks together, with their output
# Folders of the machine that a notebook ran on, which a reader of its output has not.
MACHINE = re.compile(r"/(?:tmp|home|root|work|Users|var/folders)\b[\w/.-]*|[A-Z]:\\\\Users")


def _load_run():
    spec = importlib.util.spec_from_file_location("run_notebooks", NOTEBOOKS / "run.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_notebook_runs(source, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    notebook = _load_run().execute(source)
    assert _problems(notebook) == []


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_pair_is_in_step(source):
    import jupytext

    cells = [[cell.source for cell in jupytext.read(path).cells] for path in (source, source.with_suffix(".ipynb"))]
    assert cells[0] == cells[1]


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_stored_output_is_complete_and_clean(source):
    import nbformat

    notebook = nbformat.read(source.with_suffix(".ipynb"), as_version=4)
    nbformat.validate(notebook)
    assert all(cell.execution_count for cell in notebook.cells if cell.cell_type == "code")
    assert any("image/png" in output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", ()))
    assert _problems(notebook) == []


def test_stored_output_is_small():
    assert sum(source.with_suffix(".ipynb").stat().st_size for source in SOURCES) < MAX_BYTES


def _problems(notebook):
    """Return the outputs that only the machine, or nobody, understands: progress, warnings, errors, paths."""
    found = []
    for number, cell in enumerate(notebook.cells, 1):
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            texts = [output.get("text", ""), data.get("text/plain", "")]
            if output.output_type == "error" or output.get("name") == "stderr":
                found.append((number, output.output_type))
            found += [(number, match[0]) for text in texts for match in MACHINE.finditer(text)]
    return found


def test_the_extra_of_make_notebooks_names_all_that_it_imports():
    """A fresh clone has nothing but what the extra installs."""
    makefile = (ROOT / "Makefile").read_text()
    rule = re.search(r"^notebooks: \$\(VENV\)/(\w+)\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    assert rule is not None
    assert rule[2] == "\t$(VENV)/bin/python notebooks/run.py\n"
    stamps = rf"^\$\(VENV\)/.*\$\(VENV\)/{rule[1]} .*: .*\n\t.* --editable '\.\[\$\(@F\)\]'$"
    assert re.search(stamps, makefile, re.MULTILINE)  # the extra has the name of its stamp
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [*project["optional-dependencies"][rule[1]], *project["dependencies"]]
    names = {re.split(r"[\[<>=]", name)[0] for name in extras}
    assert "ipykernel" in names  # the kernel, which also installs IPython
    imported = {name.split(".")[0] for path in [*SOURCES, NOTEBOOKS / "run.py"] for name in _imports(path)}
    assert imported - set(sys.stdlib_module_names) - {"ha2g_jax", "inspection", "IPython"} <= names


def _imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""
