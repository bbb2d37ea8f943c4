"""A self-contained HTML page of training runs: curves, states, settings that differ, and pictures of the motion."""

import html
import importlib.resources
import os
import pathlib
import string
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import whole_file
from ha2g_jax.progress import progress_bar, stage
from ha2g_jax.train.metrics_file import METRICS, read_metrics
from ha2g_jax.train.report import tables
from ha2g_jax.train.report.chart import check_matplotlib, curve_chart
from ha2g_jax.train.report.curves import Curve, Metrics, is_logarithmic, make_curves, value_range
from ha2g_jax.train.report.lines import Line, make_lines
from ha2g_jax.train.report.runs import DAMAGED, VALIDATION, Run, find_workdirs, read_runs
from ha2g_jax.train.report.samples import SECONDS, Samples, make_samples
from ha2g_jax.train.report.series import Series, to_series

SMOOTHING = 0.04  # width of the running mean as a fraction of the steps

_LOSS, _STEPS_PER_SECOND = "loss/", "steps_per_second"
# Heading -> beginnings of the names of metrics; the loss terms are apart, and "Others" has the rest.
_SECTIONS = {
    "Gradients": ("grad_norm/", "gradient_ratio/"),
    "Learning rates": ("learning_rate/",),
    "Speed": (_STEPS_PER_SECOND, "windows_per_second", "waiting_percent"),
    "Others": ("",),
}
_TITLES = {
    "grad_norm/": "norm of the gradient, ",
    "gradient_ratio/": "gradient over that of the reconstruction, ",
    "learning_rate/": "learning rate, ",
    _STEPS_PER_SECOND: "steps per second",
    "windows_per_second": "windows per second",
    "waiting_percent": "% of the time waiting for data",
}


def write_report(
    folders: Sequence[str | os.PathLike],
    out: str | os.PathLike,
    *,
    smoothing: float = SMOOTHING,
    num_clips: int = 2,
) -> pathlib.Path:
    """Write the page of one or several runs. Equal workdirs give equal pages.

    Args:
        folders: workdirs, or folders with workdirs below them.
        out: path of the page, an `.html` in a folder that exists.
        smoothing: width of the running mean of training metrics, as a fraction of the steps of the longest run; 0 for
            none. Validation scores are not smoothed.
        num_clips: number of validation clips whose motion is drawn; 0 for none.

    Returns:
        Path of the page, which is written completely or not at all.

    Raises:
        UserError: a folder has no run, no run can be read, an argument is out of range, matplotlib is missing, or the
            page cannot be written.
    """
    out = pathlib.Path(out)
    _check(out, smoothing, num_clips)
    check_matplotlib()
    runs = read_runs([path for folder in folders for path in find_workdirs(folder)])
    if all(run.state == DAMAGED for run in runs):
        more = f" and {len(runs) - 1} more runs" if runs[1:] else ""
        raise UserError(f"{shown(runs[0].path)}{more} cannot be read ({runs[0].reason}); name other runs")
    lines = make_lines(runs)
    with stage("reading the metrics"):
        metrics = {run.path: _read_metrics(run) for run in runs if run.state != DAMAGED}
    width = smoothing * max(run.step for run in runs)
    samples = make_samples(lines, num_clips) if num_clips else None
    sections = [
        f"<h1>{html.escape(_title(runs))}</h1>",
        tables.legend(lines),
        tables.how_to_read(lines, width),
        "<h2>Runs</h2>" + tables.run_table(runs, lines),
        *tables.setting_section(lines),
        *_chart_sections(lines, metrics, width),
        *_sample_section(samples),
    ]
    template = importlib.resources.files("ha2g_jax") / "assets" / "training_report.html"
    page = string.Template(template.read_text(encoding="utf-8")).substitute(
        title=html.escape(_title(runs)), toggles=tables.toggles(lines), body="\n".join(sections)
    )
    with whole_file(out) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return out


def _check(out: pathlib.Path, smoothing: float, num_clips: int) -> None:
    if out.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"the report is an HTML page, not {shown(out.name)}; name it {shown(out.name)}.html")
    if not out.absolute().parent.is_dir():
        raise UserError(f"there is no folder {shown(out.parent)} for the page; make it, or name another -o")
    if not 0 <= smoothing <= 1:
        raise UserError(f"the smoothing is {smoothing:g}; give a fraction of the steps from 0 to 1, such as 0.02")
    if num_clips < 0:
        raise UserError(f"the number of clips is {num_clips}; give 0 or more")


def _title(runs: Sequence[Run]) -> str:
    return f"Training of {runs[0].name}" if len(runs) == 1 else f"Training of {len(runs)} runs"


def _read_metrics(run: Run) -> dict[str, Series]:
    """Return the metrics of a run, and its steps per second, for which the log has the windows."""
    if not (run.path / METRICS).is_file():
        return {}
    metrics = to_series(read_metrics(run.path / METRICS))
    if windows := metrics.get("windows_per_second"):
        metrics[_STEPS_PER_SECOND] = windows._replace(values=windows.values / run.settings["train.batch_size"])
    return metrics


def _chart_sections(lines: Sequence[Line], metrics: Metrics, width: float) -> Iterator[str]:
    """Yield the sections of charts: loss terms with their validation beside them, then all others."""
    names = list(dict.fromkeys(name for series in metrics.values() for name in series))
    if not names:
        yield "<h2>Curves</h2><p>No run has written metrics yet.</p>"
        return
    losses = _in_order([name for name in names if name.removeprefix(VALIDATION).startswith(_LOSS)], lines)
    rest = [name for name in names if name.removeprefix(VALIDATION) not in losses]
    with progress_bar("drawing the charts", len(names), "chart") as bar:
        page = _Page(lines, metrics, width, bar.update)
        if losses:
            yield "<h2>Loss terms</h2>"
        for name in losses:
            yield page.row(name.removeprefix(_LOSS), {"training": name, "validation": VALIDATION + name})
        for heading, beginnings in _SECTIONS.items():
            if mine := [name for name in rest if name.startswith(beginnings)]:
                rest = [name for name in rest if name not in mine]
                mine.sort(key=lambda name: [name.startswith(beginning) for beginning in beginnings], reverse=True)
                yield f'<h2>{heading}</h2><div class="charts">{"".join(map(page.single, mine))}</div>'


def _in_order(names: Iterable[str], lines: Sequence[Line]) -> list[str]:
    """Return the loss terms of training and validation: those that choose the best checkpoint first, then the total."""
    first = {str(run.settings["train.best_by"]): 0 for line in lines for run in line.runs}
    terms = dict.fromkeys(name.removeprefix(VALIDATION) for name in names)
    return sorted(terms, key=lambda name: first.get(name, 1 if name == "loss/total" else 2))


class _Page:
    """The charts of a page, whose horizontal axes are the same."""

    def __init__(self, lines: Sequence[Line], metrics: Metrics, width: float, count: Callable[[int], object]) -> None:
        self._lines, self._metrics, self._width, self._count = lines, metrics, width, count
        self._steps = (0.0, float(max(run.step for line in lines for run in line.runs)))

    def row(self, term: str, names: Mapping[str, str]) -> str:
        """Make the charts of one term side by side, with the same vertical axis."""
        curves = {kind: self._curves(name) for kind, name in names.items()}
        curves = {kind: found for kind, found in curves.items() if found}
        if not curves:
            return ""
        values = value_range([curve for found in curves.values() for curve in found])
        figures = [self._figure(f"{term}, {kind}", found, values, names[kind]) for kind, found in curves.items()]
        return f'<div class="charts">{"".join(figures)}</div>'

    def single(self, name: str) -> str:
        """Make the chart of one metric."""
        curves = self._curves(name)
        beginning = next((each for each in _TITLES if name.startswith(each)), "")
        title = _TITLES.get(beginning, "") + name.removeprefix(beginning)
        return self._figure(title, curves, value_range(curves), name) if curves else ""

    def _curves(self, name: str) -> list[Curve]:
        self._count(1)
        return make_curves(name, self._lines, self._metrics, 0.0 if name.startswith(VALIDATION) else self._width)

    def _figure(self, title: str, curves: Sequence[Curve], values: tuple[float, float], name: str) -> str:
        scale = ", logarithmic" if is_logarithmic(*values) else ""
        label = f"{title} by step{scale}: {'; '.join(curve.label for curve in curves)}. The table below has its values."
        chart = curve_chart(curves, label, self._steps, values, name=name)
        values_table = tables.value_table(curves, has_best=name.startswith(VALIDATION))
        return f"<figure><figcaption>{html.escape(title)}<i>{scale}</i></figcaption>{chart}{values_table}</figure>"


def _sample_section(samples: Samples | None) -> Iterator[str]:
    if samples is None:
        return
    yield (
        "<h2>Motion</h2><p>The first run of each line generates motion for clips of the validation split. The pictures "
        f"are evenly over the first {SECONDS:g} s.</p>"
    )
    notes = "".join(f"<li>{html.escape(f'{label}: {note}')}</li>" for label, note in samples.notes.items())
    yield f"<ul>{notes}</ul>"
    for clip in samples.clips:
        yield f"<h3>{html.escape(f'{clip.clip}, speaker {clip.speaker}')}</h3>"
        for strip in clip.strips:
            kind = "" if strip.number is None else f' class="line-{strip.number}"'
            label = html.escape(strip.label)
            yield (
                f'<figure{kind}><figcaption>{label}</figcaption><img class="strip" '
                f'alt="Pictures of the motion, {label}" src="data:image/jpeg;base64,{strip.picture}"></figure>'
            )
