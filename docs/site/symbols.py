"""Where a name is defined in a Python file."""

import ast
import pathlib


def line_of(path: pathlib.Path, symbol: str) -> int | None:
    """Return the line, from 1, on which a symbol is defined; None if the file does not define it.

    Args:
        path: Python file.
        symbol: name of a function, a class or a variable of the module, or of a class in it: "HA2G.infer".
    """
    line, body = None, ast.parse(path.read_text(encoding="utf-8")).body
    for name in symbol.split("."):
        node = next((node for node in body if name in _names(node)), None)
        if node is None:
            return None
        line, body = node.lineno, getattr(node, "body", [])
    return line


def _names(node: ast.stmt) -> list[str]:
    """Return the names that a statement defines."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
