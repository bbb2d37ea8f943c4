"""Parts of the page without curves: the legend, which hides lines, and tables of runs, settings and values."""

import html
from collections.abc import Iterator, Sequence

from ha2g_jax.evaluation.corpus.charts import table
from ha2g_jax.train.report.chart import colour, dashes
from ha2g_jax.train.report.curves import Curve, last_values
from ha2g_jax.train.report.lines import ABSENT, SEED, Line, differing, value_text
from ha2g_jax.train.report.runs import Run


def legend(lines: Sequence[Line]) -> str:
    """Make the list of lines with a box for each, which hides the line in all charts and tables."""
    entries = []
    for number, line in enumerate(lines):
        seeds = ", ".join(value_text(run.settings, SEED) for run in line.runs)
        count = f"{len(line.runs)} runs, seeds {seeds}" if line.runs[1:] else f"1 run, seed {seeds}"
        entries.append(
            f'<li><label><input type="checkbox" id="show-{number}" checked>{_swatch(number)}'
            f"<b>{html.escape(line.label)}</b> <span>{html.escape(count)}</span></label></li>"
        )
    return f'<ul class="legend" aria-label="Lines of the charts">{"".join(entries)}</ul>'


def toggles(lines: Sequence[Line]) -> str:
    """Return the rules of style by which the boxes of `legend` hide lines."""
    return "\n".join(
        f"body:has(#show-{number}:not(:checked)) .line-{number} {{ display: none }}" for number in range(len(lines))
    )


def how_to_read(lines: Sequence[Line], width: float) -> str:
    """Say what lines, bands and values of the charts are.

    Args:
        lines: lines of the page.
        width: number of steps of the running mean.
    """
    texts = [
        f"Training curves are running means over {width:,.0f} steps; validation scores are as measured."
        if width >= 1
        else "Curves are not smoothed."
    ]
    if any(line.runs[1:] for line in lines):
        texts.append(
            "Runs whose configs differ only in the seed are one line: the mean of the seeds, with a band from the "
            "least to the greatest of them. It is faint where some of its runs have no value."
        )
    if any(not line.runs[1:] for line in lines):
        texts.append(
            "The thin line beside that of a single run has the values as logged, of a long run the least and the "
            "greatest of each part."
        )
    texts.append("Values in tables are those of the lines, at the last step that all runs of a line have reached.")
    return f'<p class="quiet">{" ".join(texts)}</p>'


def run_table(runs: Sequence[Run], lines: Sequence[Line]) -> str:
    """Make the table of runs with state, progress, best score and starts."""
    labels = {run.path: line.label for line in lines for run in line.runs}
    rows = [["run", "line", "state", "step", "best validation score", "at step", "starts at step", "last change (UTC)"]]
    for run in runs:
        best = [f"{run.best.name} {run.best.value:.4g}", f"{run.best.step:,}"] if run.best else [ABSENT, ABSENT]
        step = ABSENT if run.steps is None else f"{run.step:,} of {run.steps:,}"
        starts = ", ".join(f"{start:,}" for start in run.starts) or ABSENT
        rows.append(
            [run.name, labels.get(run.path, ABSENT), run.state, step, *best, starts, f"{run.changed:%Y-%m-%d %H:%M}"]
        )
    reasons = [f"<li>{html.escape(f'{run.name} {run.state}: {run.reason}')}</li>" for run in runs if run.reason]
    return table(rows) + (f'<ul class="reasons">{"".join(reasons)}</ul>' if reasons else "")


def setting_section(lines: Sequence[Line]) -> Iterator[str]:
    """Yield the section with the settings in which lines differ, without the seed."""
    if not lines[1:]:
        return
    yield "<h2>Settings that differ</h2>"
    firsts = [line.runs[0] for line in lines]
    names = [name for name in differing(firsts) if name != SEED]
    if not names:
        yield "<p>None but the seed: some of these runs have both the same config and the same seed.</p>"
        return
    rows = [["setting", *(line.label for line in lines)]]
    rows += [[name, *(value_text(run.settings, name) for run in firsts)] for name in names]
    yield table(rows)


def value_table(curves: Sequence[Curve], *, has_best: bool) -> str:
    """Make the table of the last values of a chart.

    Args:
        curves: curves of the chart.
        has_best: whether the least value and its step are columns.
    """
    has_spread = any(curve.low is not None for curve in curves)
    head = ["line", "last", *["seeds"] * has_spread, "step", *["least", "at step"] * has_best]
    rows = []
    notes = []
    for curve in curves:
        last = last_values(curve)
        seeds = f"{_number(last.low)} to {_number(last.high)}" if curve.low is not None else ABSENT
        cells = [_number(last.value), *[seeds] * has_spread, f"{last.step:,}"]
        cells += [_number(last.best), f"{last.best_step:,}"] if has_best else []
        body = "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        name = f"{_swatch(curve.number)}{html.escape(curve.label)}"
        rows.append(f'<tr class="line-{curve.number}"><th scope="row">{name}</th>{body}</tr>')
        if curve.num_left_out:
            text = f"{curve.label}: {curve.num_left_out:,} logged values are not finite and left out"
            notes.append(f'<p class="quiet line-{curve.number}">{html.escape(text)}</p>')
    titles = "".join(f'<th scope="col">{cell}</th>' for cell in head)
    return (
        f'<div class="wide"><table><thead><tr>{titles}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
        f"{''.join(notes)}"
    )


def _swatch(number: int) -> str:
    pattern = f' stroke-dasharray="{" ".join(map(str, dashes(number)))}"' if dashes(number) else ""
    return (
        '<svg class="swatch" viewBox="0 0 28 10" aria-hidden="true">'
        f'<line x1="1" y1="5" x2="27" y2="5" stroke-width="3" style="stroke: {colour(number)}"{pattern}/></svg>'
    )


def _number(value: float) -> str:
    return f"{value:.4g}"
