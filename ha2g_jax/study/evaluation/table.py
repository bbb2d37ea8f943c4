"""The results of an evaluation as text for a terminal and as Markdown."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ha2g_jax.errors import UserError
from ha2g_jax.study.evaluation.metrics import LEGACY_METRICS, METRICS, SANITY_ROWS, Metric

CLOSER = "Closer to ground truth is better; no column is better for being higher or lower."

_COLUMNS = 4  # of a part of the table, for 120 characters
_NAME_WIDTH, _WIDTH = 24, 24


def as_table(results: Mapping[str, Any]) -> str:
    """What `evaluation.evaluate` returns, for a terminal: value [95 % interval] in each cell.

    Raises:
        UserError: a sanity row is missing.
    """
    lines = _head(results)
    for title, rows, metrics in _parts(results):
        titles = "".join(f"{metric.title:>{_WIDTH}}" for metric in metrics.values())
        lines += ["", title, " " * _NAME_WIDTH + titles]
        for name, row in rows.items():
            shown = name if len(name) <= _NAME_WIDTH else f"{name[: _NAME_WIDTH - 3]}..."
            cells = (_cell(row.get(key), metric) for key, metric in metrics.items())
            lines.append("".join([f"{shown:<{_NAME_WIDTH}}", *(f"{cell:>{_WIDTH}}" for cell in cells)]).rstrip())
    return "\n".join([*lines, *_foot(results, "")])


def as_markdown(results: Mapping[str, Any]) -> str:
    """What `evaluation.evaluate` returns, as Markdown.

    Raises:
        UserError: a sanity row is missing.
    """
    lines = _head(results)
    for title, rows, metrics in _parts(results):
        lines += ["", f"**{title}**", "", _markdown_row(["", *(metric.title for metric in metrics.values())])]
        lines.append(_markdown_row(["---", *("---:" for _ in metrics)]))
        for name, row in rows.items():
            lines.append(_markdown_row([name, *(_cell(row.get(key), metric) for key, metric in metrics.items())]))
    return "\n".join([*lines, *_foot(results, "- ")]) + "\n"


def _head(results: Mapping[str, Any]) -> list[str]:
    if missing := [name for name in SANITY_ROWS if name not in results["rows"]]:
        raise UserError(f"the results lack {', '.join(missing)}, rows without which they say nothing; evaluate again")
    data, settings, encoder = results["data"], results["settings"], results["autoencoder"]
    windows = f", {data['windows']} windows" if data["windows"] else ""
    lines = [
        f"{data['clips']} clips of {data['sources']} sources, {data['seconds']:.0f} s{windows}; {data['skeleton']} at "
        f"{data['fps']:g} frames per second, from frame {settings['first_frame']} on; seed {settings['seed']}",
        f"Value [{settings['level']:.0%} interval: {settings['draws']} draws of sources]. {CLOSER}",
    ]
    if encoder:
        lines.append(
            f"Pose auto-encoder: SHA-256 {encoder['id'][:16]}, trained on {encoder['data'] or 'unknown data'}, "
            f"{encoder['latent_dim']} latent values of {encoder['window']} frames at {encoder['fps']:g} a second; mean "
            f"error of a coordinate on ground truth {encoder['reconstruction_error']:.4f}"
        )
    return lines


def _parts(results: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any], dict[str, Metric]]]:
    """Title, rows and columns of each part of the table."""
    yield from _divided(results["rows"], METRICS)
    for title, rows, metrics in _divided(results["differences"], METRICS):
        yield f"Paired differences. {title}", rows, metrics
    if "legacy_v1" in results:
        yield from _divided(results["legacy_v1"]["rows"], LEGACY_METRICS)


def _divided(
    rows: dict[str, Any], metrics: Mapping[str, Metric]
) -> Iterator[tuple[str, dict[str, Any], dict[str, Metric]]]:
    """Groups of the metrics that some row has, in parts of about equal size."""
    present = {key: metric for key, metric in metrics.items() if any(_has(row, key) for row in rows.values())}
    for group in dict.fromkeys(metric.group for metric in present.values()):
        keys = [key for key, metric in present.items() if metric.group == group]
        num_parts = -(-len(keys) // _COLUMNS)
        edges = [len(keys) * part // num_parts for part in range(num_parts + 1)]
        for start, end in itertools.pairwise(edges):
            title = group if not start else f"{group}, continued"
            yield title, rows, {key: present[key] for key in keys[start:end]}


def _has(row: Mapping[str, Any], key: str) -> bool:
    return key in row and row[key]["value"] is not None


def _cell(score: Mapping[str, float | None] | None, metric: Metric) -> str:
    if score is None or score["value"] is None:
        return "-"
    value, low, high = score["value"], score["low"], score["high"]
    text = f"{_rounded(value, metric.digits)}"
    deviation = score.get("sd")
    if deviation is not None:
        text += f" ±{_rounded(deviation, metric.digits)}"
    if low is None or high is None:
        return text
    return f"{text} [{_rounded(low, metric.digits)}, {_rounded(high, metric.digits)}]"


def _rounded(value: float, digits: int) -> str:
    """Fewer digits after the point for large numbers, so that cells keep their width; no minus before zero."""
    digits = max(0, digits - max(0, len(str(int(abs(value)))) - 1))
    return f"{value:.{digits}f}" if round(value, digits) else f"{0:.{digits}f}"


def _foot(results: Mapping[str, Any], bullet: str) -> list[str]:
    lines = [*_counts(results)]
    legacy = results.get("legacy_v1", {}).get("notes", ())
    for title, sentences in (
        ("Flags", results["flags"]),
        ("Warnings", results["warnings"]),
        ("Notes", [*results["notes"], *(f"legacy_v1: {note}" for note in legacy)]),
    ):
        if sentences:
            lines += ["", f"{title}:", *([""] if bullet else []), *(f"{bullet or '  '}{text}" for text in sentences)]
    return lines


def _counts(results: Mapping[str, Any]) -> Sequence[str]:
    """A line on the sound: clips used, silent and still, by row where rows differ."""
    counts = {name: count for name, count in results["counts"].items() if count}
    if not counts:
        return []
    truth = next(iter(counts.values())) if "ground truth" not in counts else counts["ground truth"]
    still = ", ".join(f"{name} {count['num_still']:.0f}" for name, count in counts.items() if count["num_still"])
    rate = truth["onsets_per_second"]
    return [
        "",
        f"Beats: {truth['num_used']:.0f} clips scored with {'no' if rate is None else f'{rate:.2f}'} onsets/s, "
        f"{truth['num_silent']:.0f} silent and not scored; clips without a motion beat: {still or 'none'}",
    ]


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
