"""The file `metrics.jsonl` of a workdir: written line by line, and read again whatever a killed run left of it."""

import json
import pathlib
from collections.abc import Iterator

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import parse_json, reading, shown
from ha2g_jax.limits import MAX_METRICS_LINE
from ha2g_jax.train.writing import replacing, writing

METRICS = "metrics.jsonl"


class MetricsFile:
    """Append to `metrics.jsonl`: one JSON object per line, numbers with six digits.

    Args:
        path: path of the file.
        step: step at which the run starts; lines of later steps and an incomplete last line are dropped.
    """

    def __init__(self, path: pathlib.Path, step: int):
        self._path = path
        with replacing(path) as temporary, temporary.open("w") as file:
            file.writelines(json.dumps(line) + "\n" for line in _lines(path) if line["step"] <= step)

    def write(self, step: int, metrics: dict[str, float]) -> None:
        """Append the line of a step."""
        rounded = {name: float(f"{value:.6g}") for name, value in metrics.items()}
        # The file is opened for each line, so that nothing stays in a buffer, not even that of a network disk.
        with writing(self._path), self._path.open("a") as file:
            file.write(json.dumps({"step": step} | rounded) + "\n")

    def close(self) -> None:
        """Do nothing: every line is already written."""


def read_metrics(path: pathlib.Path, containing: str = "") -> list[dict[str, float]]:
    """Return the lines of a `metrics.jsonl`.

    Args:
        path: path of the file.
        containing: text of the lines to return beside the last one; to skip a line takes little time.

    Raises:
        UserError: there is no such file.
    """
    with reading(path, "the metrics of a run"):
        if path.is_file():
            return list(_lines(path, containing))
    raise UserError(f"no metrics in {shown(path)}; expected the metrics.jsonl of a workdir")


def _lines(path: pathlib.Path, containing: str = "") -> Iterator[dict[str, float]]:
    """Yield the complete lines; a run that was killed may leave an incomplete one, and damage may leave any."""
    if not path.exists():
        return
    skipped = ""
    with path.open(errors="replace") as file:
        while text := file.readline(MAX_METRICS_LINE):
            if containing not in text:
                skipped = text if text.endswith("\n") else skipped
            elif (line := _parse(text)) is not None:
                skipped = ""
                yield line
    if (line := _parse(skipped)) is not None:
        yield line


def _parse(text: str) -> dict[str, float] | None:
    try:
        line = parse_json(text) if text.endswith("\n") else None
    except ValueError:
        return None
    if not isinstance(line, dict) or type(line.get("step")) is not int:
        return None
    return line if all(isinstance(value, int | float) for value in line.values()) else None
