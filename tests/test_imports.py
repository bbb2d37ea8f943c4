"""Imports run one way (pyproject.toml, [tool.importlinter]) and never in a circle."""

import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parent.parent


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
