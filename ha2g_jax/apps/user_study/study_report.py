"""The report of a user study, as Markdown and as an HTML page, from the numbers of `analysis.analyse`.

Names of systems, files and participants and all comments are untrusted text: they are escaped here, and the page
allows no script.
"""

import base64
import html
import importlib.resources
import json
import math
import pathlib
import re
import string
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ha2g_jax.evaluation.charts import Mark, html_table, interval_chart, markdown, number, printable
from ha2g_jax.files.writing import whole_file, writing
from ha2g_jax.progress import counted

_TESTS = ("p", "p, Holm", "exact p [95 %]", "equal as half")
_INTERVALS = """\
Intervals are of 95 % and about other participants and other clips: their variance is that over participants plus \
that over clips (jackknife), with the degrees of freedom of min F' (Clark 1973). They tend to be too wide rather than \
too narrow. With one clip they are only about other participants; if all answers agree there is none."""

_DIFFERENCES = """\
First system minus second, by least squares with an effect of each system, participant and clip: the difference of the \
means where every participant rates everything. p is for the hypothesis of no difference; "p, Holm" is corrected for \
all pairs of a scale, not for several scales."""

_PREFERENCE = """\
Numbers of choices, and the share of the first system among the choices that prefer one, with the interval of Korn \
and Graubard (1998) over participants and clips. p is of a share of a half for the same sampling, "p, Holm" is \
corrected for all pairs. The exact p is of the binomial test, which treats all choices as independent; choices of one \
participant depend on each other, so that it is too small as a rule. Equal as half: the share if choices for neither \
count half."""

_STRENGTHS = """\
Strengths of Bradley and Terry: with a difference d, the first system is preferred with probability 1 / (1 + exp(-d)) \
where one is preferred. Choices for neither do not count. Strengths are relative to the mean of the largest group of \
systems that were preferred to each other, directly or through others (of all such groups, if several are as large); \
1500 on Elo's scale is that mean, and 400 points are odds of 10. Intervals are not corrected for the number of pairs."""

_INFINITE = """\
Always or never preferred, at least to a group of the others, so that the answers set no bound on one side, and the \
value itself is due to the correction of the bias"""

_NOT_CONNECTED = """\
The choices do not connect all systems with each other, directly or through others, so that there are no strengths on \
one scale."""

_MISMATCH = """\
Participants saw the motion of a clip and the motion of another clip with the same sound, and chose which fits the \
speech. The share is of matched motion among the choices that prefer one; a half is what motion without relation to \
the speech reaches. Its interval (Korn and Graubard 1998) and p allow for choices that depend on the participant and \
on the clip; "p, Holm" is corrected for all systems. The exact p is of the binomial test, with the interval of \
Clopper and Pearson; they treat all choices as independent, and are too small and too narrow where participants \
differ. Equal as half: the share if choices for neither count half."""

_AGREEMENT = """\
Agreement of participants on the same item beyond chance (Fleiss 1971): 0 is chance, 1 is perfect. Items with fewer \
than two answers do not count. The numbers of a scale are taken as names, so that 4 and 5 differ as much as 1 and 5: \
kappa of ratings is low as a rule."""

PAGE, MARKDOWN, NUMBERS = "report.html", "report.md", "report.json"
"""Files of the folder; charts are beside them as `.svg`."""

CHARTS = frozenset({"opinion", "differences", "strengths", "mismatch"})
"""Names of the charts; a report has those that its answers allow."""

_SPECIAL = re.compile(r"([\\`*_\[\]~$@]|:(?=//)|(?<=www)\.)")  # links that are made without brackets, too


class Table(NamedTuple):
    """A table, whose first row is its header. Cells are untrusted plain text."""

    rows: Sequence[Sequence[str]]


class Chart(NamedTuple):
    """A chart of estimates with their intervals, see `interval_chart`; `name` is that of its file."""

    name: str
    label: str
    rows: Mapping[str, Mapping[str, Mark]]
    axis: str
    reference: float | None = None


class Section(NamedTuple):
    """A section with its heading; its parts are paragraphs of plain text, tables and charts."""

    heading: str
    parts: Sequence[str | Table | Chart]


def sections(results: Mapping[str, Any]) -> list[Section]:
    """Return the sections of the report, the first of which has the title."""
    found = [_head(results)]
    found += _opinion(results["opinion"]) if results["opinion"] else []
    for name, write in {"preference": _preference, "mismatch": _mismatch, "agreement": _agreement}.items():
        if results[name]:
            found.append(write(results[name]))
    found.append(_exclusions(results["excluded"]))
    if results["comments"]:
        rows = [("participant", "comment")]
        rows += [(one["participant"], " ".join(one["text"].split())) for one in results["comments"]]
        found.append(Section("Comments", ["Texts of participants, as they wrote them.", Table(rows)]))
    return found


def _head(results: Mapping[str, Any]) -> Section:
    counts = ", ".join(f"{count} of kind {kind}" for kind, count in results["answers"].items())
    kept, left_out = len(results["participants"]), len(results["excluded"])
    parts = [f"{counted(kept, 'participant')} kept, {counted(left_out, 'answer file')} excluded."]
    parts += [f"Answers: {counts}."] if counts else []
    if kept == 1:
        parts.append(
            "With one participant there are no intervals and no tests: nothing is known of other participants."
        )
    parts.append(f"Study {results['study']}. {_INTERVALS}")
    if kept == 0:
        parts.append(
            "No participant is left, so that there is nothing to analyse. The section Excluded has the reasons."
        )
    return Section(f"User study: {results['title']}", parts)


def _opinion(opinion: Mapping[str, Any]) -> list[Section]:
    scales = opinion["scales"]
    systems = list(next(iter(scales.values()))["means"])
    rows: list[Sequence[str]] = [("system", *scales, "ratings")]
    for system in systems:
        mine = [scale["means"][system] for scale in scales.values()]
        rows.append((system, *map(_interval, mine), str(mine[0]["ratings"])))
    marks = {system: {scale: _mark(each["means"][system]) for scale, each in scales.items()} for system in systems}
    label = "Mean opinion score of each system, with 95 % intervals"
    low, high = opinion["points"]
    chart = Chart("opinion", label, marks, f"mean opinion score, {low} to {high}")
    found = [Section("Mean opinion scores", ["Means of all ratings.", Table(rows), chart])]
    if len(systems) < 2:
        return found
    rows = [("scale", "difference", "value [95 %]", "p", "p, Holm")]
    differences: dict[str, dict[str, Mark]] = {}
    for scale, each in scales.items():
        for one in each["differences"]:
            name = _minus(one)
            rows.append((scale, name, _interval(one), _p(one["p"]), _p(one["p_holm"])))
            differences.setdefault(name, {})[scale] = _mark(one)
    label = "Differences of mean opinion scores, with 95 % intervals"
    parts = [_DIFFERENCES, Table(rows), Chart("differences", label, differences, "difference of scores", 0)]
    return [*found, Section("Differences between systems", parts)]


def _preference(preference: Mapping[str, Any]) -> Section:
    rows: list[Sequence[str]] = [("first", "second", "first / equal / second", "share of the first [95 %]", *_TESTS)]
    for one in preference["pairs"]:
        rows.append((one["first"], one["second"], _counts(one), *_tests(one)))
    parts: list[str | Table | Chart] = [_PREFERENCE, Table(rows)]
    if not preference["strengths"]:
        parts.append("No choice prefers a system, so that there are no strengths.")
    elif not preference["is_connected"]:
        parts.append(_NOT_CONNECTED)
    else:
        parts += _strengths(preference)
    return Section("Preferences between systems", parts)


def _strengths(preference: Mapping[str, Any]) -> list[str | Table | Chart]:
    strengths = preference["strengths"]
    parts: list[str | Table | Chart] = [_STRENGTHS]
    if infinite := [name for name, one in strengths.items() if not one["is_finite"]]:
        parts.append(f"{_INFINITE}: {', '.join(infinite)}.")
    if preference["missing"]:
        parts.append(
            f"Without a choice that prefers one, and therefore not in the table: {', '.join(preference['missing'])}."
        )
    ranked = sorted(strengths.items(), key=lambda item: -item[1]["value"])
    rows: list[Sequence[str]] = [("system", "strength, logits [95 %]", "Elo")]
    rows += [(name, _interval(one), f"{one['elo']:.0f}") for name, one in ranked]
    marks = {name: {"strength": _mark(one)} for name, one in ranked}
    label = "Bradley-Terry strength of each system, with 95 % intervals"
    parts += [Table(rows), Chart("strengths", label, marks, "strength in logits", 0)]
    rows = [("difference of strengths", "value [95 %]", "first is preferred")]
    for one in preference["differences"]:
        rows.append((_minus(one), _interval(one), f"{1 / (1 + math.exp(-one['value'])):.0%}"))
    return [*parts, Table(rows)]


def _mismatch(mismatch: Mapping[str, Any]) -> Section:
    rows: list[Sequence[str]] = [("system", "matched / equal / mismatched", "share of matched [95 %]", *_TESTS)]
    for one in mismatch["systems"]:
        rows.append((one["system"], _counts(one), *_tests(one)))
    label = "Share of choices for the motion with its own speech, with 95 % intervals"
    marks = {one["system"]: {"share": _mark(one)} for one in mismatch["systems"]}
    chart = Chart("mismatch", label, marks, "share that prefers matched motion", 0.5)
    return Section("Matched against mismatched speech", [_MISMATCH, Table(rows), chart])


def _agreement(agreement: Mapping[str, Any]) -> Section:
    rows: list[Sequence[str]] = [("answers", "Fleiss' kappa [95 %]", "items", "answers per item")]
    for name, one in agreement.items():
        rows.append((name, _interval(one), str(one["items"]), f"{one['answers_per_item']:.1f}"))
    return Section("Agreement", [_AGREEMENT, Table(rows)])


def _exclusions(excluded: Sequence[Mapping[str, str]]) -> Section:
    if not excluded:
        return Section("Excluded", ["Nothing was excluded."])
    rows = [("file", "participant", "reason")]
    rows += [(one["file"], one["participant"] or "-", one["reason"]) for one in excluded]
    return Section("Excluded", ["These files are in none of the numbers.", Table(rows)])


def _counts(one: Mapping[str, Any]) -> str:
    return " / ".join(str(one["choices"][name]) for name in ("first", "equal", "second"))


def _tests(one: Mapping[str, Any]) -> list[str]:
    """Format a share, the columns `_TESTS`."""
    half = _percent(one["with_half"])
    if one["value"] is None:
        return [*["-"] * 4, half]
    share, exact = _percent(one["value"]), f"[{_percent(one['exact_low'])}, {_percent(one['exact_high'])}]"
    bounds = "" if one["low"] is None else f" [{_percent(one['low'])}, {_percent(one['high'])}]"
    return [f"{share}{bounds}", _p(one["p"]), _p(one["p_holm"]), f"{_p(one['exact_p'])} {exact}", half]


def _minus(one: Mapping[str, Any]) -> str:
    return f"{one['first']} - {one['second']}"


def _mark(one: Mapping[str, Any]) -> Mark:
    return Mark(*(math.nan if one[name] is None else float(one[name]) for name in Mark._fields))


def _interval(one: Mapping[str, Any]) -> str:
    """Format a value with its interval; an infinite bound becomes a word."""
    if one["value"] is None:
        return "-"
    if one["low"] is None or one["high"] is None:
        return number(one["value"])
    low, high = ("no bound" if isinstance(one[name], str) else number(one[name]) for name in ("low", "high"))
    return f"{number(one['value'])} [{low}, {high}]"


def _p(value: float | None) -> str:
    if value is None:
        return "-"
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"


def write_report(results: Mapping[str, Any], out: pathlib.Path) -> pathlib.Path:
    """Write the report as HTML, as Markdown with charts, and as JSON, and return the path of the HTML page.

    Each file is written atomically. Charts of an earlier report in the folder that this one does not have are removed.

    Raises:
        UserError: a file cannot be written or removed, or matplotlib is missing.
    """
    found = sections(results)
    charts = [part for section in found for part in section.parts if isinstance(part, Chart)]
    drawn = {
        chart.name: interval_chart(chart.rows, label=chart.label, axis=chart.axis, reference=chart.reference)
        for chart in charts
    }
    files = {f"{name}.svg": svg for name, svg in drawn.items()} | {
        MARKDOWN: as_markdown(results, charts=True),
        NUMBERS: json.dumps(results, indent=1, allow_nan=False) + "\n",
        PAGE: _page(found, drawn),
    }
    for name, text in files.items():
        with whole_file(out / name) as temporary:
            temporary.write_text(text, encoding="utf-8", errors="replace")
    with writing(out):
        for name in CHARTS - drawn.keys():
            (out / f"{name}.svg").unlink(missing_ok=True)
    return out / PAGE


def as_markdown(results: Mapping[str, Any], *, charts: bool = False) -> str:
    """Return the report as Markdown, which may refer to the charts as files beside it."""
    lines = []
    for section in sections(results):
        lines += [f"{'##' if lines else '#'} {_escape(section.heading)}", ""]
        for part in section.parts:
            if isinstance(part, Table):
                lines += [markdown([[_escape(cell) for cell in row] for row in part.rows]), ""]
            elif not isinstance(part, Chart):
                lines += [_escape(part), ""]
            elif charts:
                lines += [f"![{_escape(part.label)}]({part.name}.svg)", ""]
    return "\n".join(lines)


def _page(found: Sequence[Section], charts: Mapping[str, str]) -> str:
    """Return the report as an HTML page that needs no other file and has no script."""
    parts: list[str] = []
    for section in found:
        level = "h2" if parts else "h1"
        parts.append(f"<{level}>{html.escape(printable(section.heading))}</{level}>")
        for part in section.parts:
            if isinstance(part, Table):
                parts.append(html_table([[printable(cell) for cell in row] for row in part.rows]))
            elif isinstance(part, Chart):
                data = base64.b64encode(charts[part.name].encode("utf-8", errors="replace")).decode()
                label = html.escape(printable(part.label))
                parts.append(
                    f'<p><img style="max-width:100%" alt="{label}" src="data:image/svg+xml;base64,{data}"></p>'
                )
            else:
                parts.append(f"<p>{html.escape(printable(part))}</p>")
    template = importlib.resources.files("ha2g_jax") / "assets" / "corpus_report.html"
    title = html.escape(printable(found[0].heading))
    return string.Template(template.read_text()).substitute(title=title, body="\n".join(parts))


def _escape(text: str) -> str:
    """Return a text that Markdown shows as it is: HTML and all markup are escaped."""
    return _SPECIAL.sub(r"\\\1", html.escape(printable(text), quote=False))
