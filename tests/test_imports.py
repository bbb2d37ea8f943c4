"""Imports run one way (pyproject.toml, [tool.importlinter]) and never in a circle."""

import ast
import graphlib
import pathlib
import re
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parent.parent
ADDON = ROOT / "integrations" / "blender"
PAGES = ROOT / "integrations" / "web"


def test_the_import_contracts_hold():
    pytest.importorskip("importlinter")
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command as main; main()", "--no-cache"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr


def test_import_of_the_package_does_not_start_jax():
    code = "import sys, ha2g_jax, ha2g_jax.cli; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


def test_no_module_imports_itself_through_others():
    """Imports inside functions count, too."""
    grimp = pytest.importorskip("grimp")
    graph = grimp.build_graph("ha2g_jax")
    left = {module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules}
    while free := {module for module, imported in left.items() if not imported & left.keys()}:
        left = {module: imported for module, imported in left.items() if module not in free}
    assert not left  # modules of a circle, and those that import them


def imported_by_python(path):
    """Return the modules beside a module that it imports relatively, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == 1:
            names = [node.module] if node.module else [alias.name for alias in node.names]
            yield from (path.with_name(f"{name}.py") for name in names)


def imported_by_typescript(path):
    """Return the modules of this project that a module imports, types and imports at run time included."""
    for name in re.findall(
        r"""(?:\bfrom|\bimport\(|^import)\s*["'](\.[^"']+)\.js["']""", path.read_text(), re.MULTILINE
    ):
        yield (path.parent / f"{name}.ts").resolve()


@pytest.mark.parametrize(
    ("folders", "pattern", "imported"),
    [([ADDON], "*.py", imported_by_python), ([PAGES / "src", PAGES / "site"], "*.ts", imported_by_typescript)],
)
def test_no_module_of_an_integration_imports_itself_through_others(folders, pattern, imported):
    paths = {path for folder in folders for path in folder.rglob(pattern)}
    graph = {path: set(imported(path)) & paths for path in paths}
    assert sum(map(len, graph.values())) > 10
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle
