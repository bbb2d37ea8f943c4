"""The report of a user study: sections of texts, tables and charts, from the numbers of `analysis.analyse`."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tables.tables import number

from ha2g_jax.apps.user_study import texts
from ha2g_jax.apps.user_study.charts import Mark, interval_chart

_TESTS = ("p", "p, Holm", "exact p [95 %]", "equal as half")


class Table(NamedTuple):
    """A table, whose first row is its header. Cells are plain text of any origin."""

    rows: Sequence[Sequence[str]]


class Chart(NamedTuple):
    """A chart: the name of its file, its description and an SVG document."""

    name: str
    label: str
    svg: str


class Section(NamedTuple):
    """A section with its heading; its parts are paragraphs of plain text, tables and charts."""

    heading: str
    parts: Sequence[str | Table | Chart]


def sections(results: Mapping[str, Any]) -> list[Section]:
    """Return the sections of the report, the first of which has the title.

    Args:
        results: return value of `analysis.analyse`.
    """
    found = [_head(results)]
    if not results["participants"]:
        found[0] = found[0]._replace(parts=[*found[0].parts, texts.NOTHING])
    if results["opinion"]:
        found += _opinion(results["opinion"])
    if results["preference"]:
        found.append(_preference(results["preference"]))
    if results["mismatch"]:
        found.append(_mismatch(results["mismatch"]))
    if results["agreement"]:
        found.append(_agreement(results["agreement"]))
    found.append(_exclusions(results))
    if results["comments"]:
        rows = [(one["participant"], " ".join(one["text"].split())) for one in results["comments"]]
        found.append(Section("Comments", [texts.COMMENTS, Table([("participant", "comment"), *rows])]))
    return found


def _head(results: Mapping[str, Any]) -> Section:
    counts = ", ".join(f"{count} of kind {kind}" for kind, count in results["answers"].items())
    kept, left_out = len(results["participants"]), len(results["excluded"])
    parts = [f"{_count(kept, 'participant')} kept, {_count(left_out, 'answer file')} excluded."]
    parts += [f"Answers: {counts}."] if counts else []
    if kept == 1:
        parts.append(texts.ONE_PARTICIPANT)
    return Section(f"User study: {results['title']}", [*parts, f"Study {results['study']}. {texts.INTERVALS}"])


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
    chart = interval_chart(marks, label=label, axis=f"mean opinion score, {low} to {high}")
    found = [Section("Mean opinion scores", [texts.OPINION, Table(rows), Chart("opinion", label, chart)])]
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
    chart = interval_chart(differences, label=label, axis="difference of scores", reference=0)
    parts = [texts.DIFFERENCES, Table(rows), Chart("differences", label, chart)]
    return [*found, Section("Differences between systems", parts)]


def _preference(preference: Mapping[str, Any]) -> Section:
    rows: list[Sequence[str]] = [("first", "second", "first / equal / second", "share of the first [95 %]", *_TESTS)]
    for one in preference["pairs"]:
        rows.append((one["first"], one["second"], _counts(one), *_tests(one)))
    parts: list[str | Table | Chart] = [texts.PREFERENCE, Table(rows)]
    strengths = preference["strengths"]
    if not strengths:
        return Section("Preferences between systems", [*parts, texts.NO_PREFERENCE])
    if not preference["is_connected"]:
        return Section("Preferences between systems", [*parts, texts.NOT_CONNECTED])
    parts.append(texts.STRENGTHS)
    if infinite := [name for name, one in strengths.items() if not one["is_finite"]]:
        parts.append(f"{texts.INFINITE}: {', '.join(infinite)}.")
    if preference["missing"]:
        parts.append(f"{texts.MISSING}: {', '.join(preference['missing'])}.")
    ranked = sorted(strengths.items(), key=lambda item: -item[1]["value"])
    rows = [("system", "strength, logits [95 %]", "Elo")]
    rows += [(name, _interval(one), f"{one['elo']:.0f}") for name, one in ranked]
    marks = {name: {"strength": _mark(one)} for name, one in ranked}
    label = "Bradley-Terry strength of each system, with 95 % intervals"
    chart = interval_chart(marks, label=label, axis="strength in logits", reference=0)
    parts += [Table(rows), Chart("strengths", label, chart)]
    rows = [("difference of strengths", "value [95 %]", "first is preferred")]
    for one in preference["differences"]:
        rows.append((_minus(one), _interval(one), f"{1 / (1 + math.exp(-one['value'])):.0%}"))
    return Section("Preferences between systems", [*parts, Table(rows)])


def _mismatch(mismatch: Mapping[str, Any]) -> Section:
    rows: list[Sequence[str]] = [("system", "matched / equal / mismatched", "share of matched [95 %]", *_TESTS)]
    for one in mismatch["systems"]:
        rows.append((one["system"], _counts(one), *_tests(one)))
    label = "Share of choices for the motion with its own speech, with 95 % intervals"
    marks = {one["system"]: {"share": _mark(one)} for one in mismatch["systems"]}
    chart = interval_chart(marks, label=label, axis="share that prefers matched motion", reference=0.5)
    return Section("Matched against mismatched speech", [texts.MISMATCH, Table(rows), Chart("mismatch", label, chart)])


def _agreement(agreement: Mapping[str, Any]) -> Section:
    rows: list[Sequence[str]] = [("answers", "Fleiss' kappa [95 %]", "items", "answers per item")]
    for name, one in agreement.items():
        rows.append((name, _interval(one), str(one["items"]), f"{one['answers_per_item']:.1f}"))
    return Section("Agreement", [texts.AGREEMENT, Table(rows)])


def _exclusions(results: Mapping[str, Any]) -> Section:
    if not results["excluded"]:
        return Section("Excluded", ["Nothing was excluded."])
    rows: list[Sequence[str]] = [(one["file"], one["participant"] or "-", one["reason"]) for one in results["excluded"]]
    return Section("Excluded", [texts.EXCLUDED, Table([("file", "participant", "reason"), *rows])])


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
    """Format a value with its interval; a bound that has no end is a word."""
    if one["value"] is None:
        return "-"
    if one["low"] is None or one["high"] is None:
        return number(one["value"])
    low, high = (_bound(one[name]) for name in ("low", "high"))
    return f"{number(one['value'])} [{low}, {high}]"


def _bound(value: float | str) -> str:
    return "no bound" if isinstance(value, str) else number(value)


def _p(value: float | None) -> str:
    if value is None:
        return "-"
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"


def _count(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
