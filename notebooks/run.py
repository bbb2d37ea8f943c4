"""Run notebooks and store their output in the `.ipynb` beside each: `python notebooks/run.py [NAME.py ...]`."""

import pathlib
import sys
import time
from collections.abc import Sequence

import jupytext
import nbformat
from nbclient import NotebookClient

FOLDER = pathlib.Path(__file__).parent
SOURCES = sorted(FOLDER.glob("[0-9]*.py"))


def execute(source: pathlib.Path) -> nbformat.NotebookNode:
    """Return a notebook with the output of all of its cells, run from top to bottom in its folder.

    Progress on stderr is left out of the output, as are the times and the random names of cells, so that equal output
    gives equal files.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell fails.
        RuntimeError: a cell warns.
    """
    notebook = jupytext.read(source)
    client = NotebookClient(
        notebook, timeout=3600, kernel_name="python3", record_timing=False, resources={"metadata": {"path": FOLDER}}
    )
    client.execute()
    for number, cell in enumerate(notebook.cells, 1):
        cell["id"] = f"cell-{number}"
        for output in cell.get("outputs", ()):
            if output.get("name") == "stderr" and "Warning" in output["text"]:
                raise RuntimeError(f"{source.name}, cell {number}: {output['text']}")
        if "outputs" in cell:
            cell["outputs"] = [output for output in cell["outputs"] if output.get("name") != "stderr"]
    return notebook


def main(names: Sequence[str]) -> None:
    """Run the notebooks of these files, or all, and say how long each took."""
    for source in map(pathlib.Path, names) if names else SOURCES:
        start = time.perf_counter()
        jupytext.write(execute(source), source.with_suffix(".ipynb"))
        print(f"{source.stem}: {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
