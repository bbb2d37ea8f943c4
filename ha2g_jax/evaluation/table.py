"""Results of an evaluation as text for a terminal and as Markdown."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ha2g_jax import metrics
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.charts import markdown
from ha2g_jax.metrics.metric import Metric
from ha2g_jax.metrics.sanity import SANITY_ROWS, TRUTH
from ha2g_jax.progress import counted

CLOSER = "Closer to ground truth is better; no column is better for being higher or lower."

_COLUMNS = 4  # columns in a part of the table, for 120 characters
_NAME_WIDTH, _WIDTH = 24, 24
PARTS = ("legacy_v1", "known_causes", "recording", "beat2")


def as_table(results: Mapping[str, Any]) -> str:
    """Return results of `scoring.make_results` as text for a terminal, see `section_table`."""
    parts = [_inputs(results)]
    for name, section in results["sections"].items():
        parts += ["", f"{name}:", section_table(section)]
    return "\n".join(parts)


def as_markdown(results: Mapping[str, Any]) -> str:
    """Return results of `scoring.make_results` as Markdown, see `section_markdown`."""
    parts = [_inputs(results)]
    for name, section in results["sections"].items():
        parts += ["", f"## {name}", "", section_markdown(section).rstrip()]
    return "\n".join(parts) + "\n"


def section_table(section: Mapping[str, Any]) -> str:
    """Return one section as text for a terminal: value [95 % interval] in each cell.

    Raises:
        UserError: a sanity row is missing, or a score is not registered.
    """
    lines = _head(section)
    for title, rows, columns in _parts(section):
        headings = "".join(f"{metric.heading:>{_WIDTH}}" for metric in columns.values())
        lines += ["", title, " " * _NAME_WIDTH + headings]
        for name, row in rows.items():
            shown = name if len(name) <= _NAME_WIDTH else f"{name[: _NAME_WIDTH - 3]}..."
            cells = (_cell(row.get(key), metric) for key, metric in columns.items())
            lines.append("".join([f"{shown:<{_NAME_WIDTH}}", *(f"{cell:>{_WIDTH}}" for cell in cells)]).rstrip())
    return "\n".join([*lines, *_foot(section, "")])


def section_markdown(section: Mapping[str, Any]) -> str:
    """Return one section as Markdown; the errors are those of `section_table`."""
    lines = _head(section)
    for title, rows, columns in _parts(section):
        cells = [["", *(metric.heading for metric in columns.values())]]
        cells += [
            [name, *(_cell(row.get(key), metric) for key, metric in columns.items())] for name, row in rows.items()
        ]
        lines += ["", f"**{title}**", "", markdown(cells, has_numbers=True)]
    return "\n".join([*lines, *_foot(section, "- ")]) + "\n"


def _inputs(results: Mapping[str, Any]) -> str:
    return "; ".join(f"{name} {value}" for name, value in results["inputs"].items())


def _head(section: Mapping[str, Any]) -> list[str]:
    """Return lines on the data and the settings, after a check that no sanity row is missing."""
    data, settings, encoder = section["data"], section["settings"], section["autoencoder"]
    windows = f", {counted(data['windows'], 'window')}" if data["windows"] else ""
    lines = [
        f"{counted(data['clips'], 'clip')} of {counted(data['recordings'], 'recording')}, "
        f"{data['seconds']:.0f} s{windows}; "
        f"{data['skeleton']} at {data['fps']:g} frames per second, from frame {settings['first_frame']} on; seed "
        f"{settings['seed']}",
    ]
    if "recording" in section:
        return [*lines, f"Value [{settings['level']:.0%} interval]. There is no true motion to compare with."]
    if missing := [name for name in SANITY_ROWS if name not in section["rows"]]:
        raise UserError(f"the results lack {', '.join(missing)}, rows without which they say nothing; evaluate again")
    lines.append(f"Value [{settings['level']:.0%} interval: {settings['draws']} draws of recordings]. {CLOSER}")
    if encoder:
        lines.append(
            f"Pose auto-encoder: SHA-256 {encoder['id'][:16]}, trained on {encoder['data'] or 'unknown data'}, "
            f"{encoder['latent_dim']} latent values of {encoder['window']} frames at {encoder['fps']:g} a second; mean "
            f"error of a coordinate on ground truth {encoder['reconstruction_error']:.4f}"
        )
    return lines


def _parts(section: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any], dict[str, Metric]]]:
    """Yield title, rows and columns of each part of the table."""
    yield from _divided(section["rows"])
    for title, rows, columns in _divided(section["differences"]):
        yield f"Paired differences. {title}", rows, columns
    for part in PARTS:
        if part in section:
            for title, rows, columns in _divided(section[part]["rows"]):
                yield title, {name: row for name, row in rows.items() if row.keys() & columns.keys()}, columns


def _columns(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, Metric]:
    """Return the metrics for which some row has a value, in the order of registration."""
    scores = [(metrics.lookup(name), score) for row in rows.values() for name, score in row.items()]
    present = {metric.name for metric, score in scores if score["value"] is not None}
    return {name: metric for name, metric in metrics.METRICS.items() if name in present}


def _divided(rows: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any], dict[str, Metric]]]:
    """Yield groups of the metrics that some row has, in parts of about equal size."""
    present = _columns(rows)
    for group in dict.fromkeys(metric.group for metric in present.values()):
        keys = [key for key, metric in present.items() if metric.group == group]
        num_parts = -(-len(keys) // _COLUMNS)
        edges = [len(keys) * part // num_parts for part in range(num_parts + 1)]
        for start, end in itertools.pairwise(edges):
            title = group if not start else f"{group}, continued"
            yield title, rows, {key: present[key] for key in keys[start:end]}


def _cell(score: Mapping[str, float | None] | None, metric: Metric) -> str:
    if score is None or score["value"] is None:
        return "-"
    value, low, high = score["value"], score["low"], score["high"]
    text = _rounded(value, metric.digits)
    deviation = score.get("sd")
    if deviation is not None:
        text += f" ±{_rounded(deviation, metric.digits)}"
    if low is None or high is None:
        return text
    return f"{text} [{_rounded(low, metric.digits)}, {_rounded(high, metric.digits)}]"


def _rounded(value: float, digits: int) -> str:
    """Format a value with fewer digits for large numbers, so that cells keep their width, and no minus before zero."""
    digits = max(0, digits - max(0, len(str(int(abs(value)))) - 1))
    return f"{value:.{digits}f}" if round(value, digits) else f"{0:.{digits}f}"


def _foot(section: Mapping[str, Any], bullet: str) -> list[str]:
    lines = [*_counts(section), *_known_counts(section)]
    others = [f"{part}: {note}" for part in PARTS if part in section for note in section[part]["notes"]]
    for title, sentences in (
        ("Flags", section["flags"]),
        ("Warnings", section["warnings"]),
        ("Notes", [*section["notes"], *others]),
    ):
        if sentences:
            lines += ["", f"{title}:", *([""] if bullet else []), *(f"{bullet or '  '}{text}" for text in sentences)]
    return lines


def _known_counts(section: Mapping[str, Any]) -> Sequence[str]:
    """Return a line on the clips and strokes behind the scores of known causes."""
    if "known_causes" not in section:
        return []
    counts = section["known_causes"]["counts"]
    return ["", "Known causes: " + ", ".join(f"{count} {name}" for name, count in counts.items())]


def _counts(section: Mapping[str, Any]) -> Sequence[str]:
    """Return a line on the sound: clips used, silent and still, by row where rows differ."""
    counts = {name: count for name, count in section["counts"].items() if count}
    if not counts:
        return []
    truth = counts.get(TRUTH) or next(iter(counts.values()))
    still = ", ".join(f"{name} {count['num_still']:.0f}" for name, count in counts.items() if count["num_still"])
    rate = truth["onsets_per_second"]
    return [
        "",
        f"Beats: {truth['num_used']:.0f} clips scored with {'no' if rate is None else f'{rate:.2f}'} onsets/s, "
        f"{truth['num_silent']:.0f} silent and not scored; clips without a motion beat: {still or 'none'}",
    ]
