"""HTML report of a corpus: sizes, the report of its import, statistics of speech and motion, and clips to watch."""

import base64
import html
import importlib.resources
import io
import os
import pathlib
import string
import tempfile
from collections.abc import Iterator
from typing import Any

from PIL import Image
from tqdm import tqdm

from ha2g_jax.data import recording
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.recording import SplitReport
from ha2g_jax.data.records import Clip
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.corpus.charts import fractions, histogram, ranges, table
from ha2g_jax.evaluation.corpus.motion import ANGLE_EDGES, SPEED_EDGES
from ha2g_jax.evaluation.corpus.statistics import (
    PACE_EDGES,
    SECONDS_EDGES,
    angle_rows,
    bone_rows,
    joint_rows,
    report_of,
    split_rows,
    summarise,
)
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.figure import DEFAULT_LOOK, draw_figure, fit
from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion.formats.video import write_video
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import positions_to_directions

_SAMPLE_SECONDS, _SAMPLE_SIZE = 8, 400
_LOOK_AHEAD = 100  # clips to search for a speaker who is not shown yet
_MAX_WORDS = 40  # words of a sample, written under it
_MAX_FAILURES = 50
_REASONS = {
    recording.TOO_FEW_WORDS: "too few words",
    recording.MEAN_POSE: "near the mean pose, to which an estimator falls back",
    recording.SPINE_ANGLE: "spine tilted",
    recording.MOTION: "both wrists almost still",
}


def write_report(path: str | os.PathLike, out: str | os.PathLike, *, num_samples: int = 4) -> pathlib.Path:
    """Write a self-contained HTML page with videos. Equal corpora give equal pages.

    Args:
        path: folder of the corpus.
        out: path of the page, an `.html`.
        num_samples: number of clips to watch, of different speakers if possible; 0 for none.

    Returns:
        Path of the page, which is written atomically.

    Raises:
        UserError: there is no corpus, a record cannot be used, or the page cannot be written.
    """
    out = pathlib.Path(out)
    if out.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"the report is an HTML page, not {out.name!r}; name it {out.name}.html")
    corpus = Corpus.open(path)
    summary = summarise(path)
    sections = [
        _head(summary),
        _numbers(summary),
        *_samples(corpus, num_samples),
        "<h2>Splits</h2>" + table(split_rows(summary)),
        *_import(summary),
        *_speech(summary),
        *_motion(summary),
    ]
    template = importlib.resources.files("ha2g_jax") / "assets" / "corpus_report.html"
    title = html.escape(f"{summary['name']}: corpus report")
    page = string.Template(template.read_text()).substitute(title=title, body="\n".join(sections))
    with whole_file(out) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return out


def _head(summary: dict[str, Any]) -> str:
    facts = {
        "source": summary["source"],
        "licence": summary["licence"],
        "skeleton": f"{summary['skeleton']}, {summary['fps']:g} frames per second",
    }
    rows = "".join(f"<dt>{name}</dt><dd>{html.escape(text or 'not stated')}</dd>" for name, text in facts.items())
    return f"<h1>{html.escape(summary['name'])}</h1><dl>{rows}</dl>"


def _numbers(summary: dict[str, Any]) -> str:
    """Make the list of the most important numbers."""
    total, reports = summary["total"], report_of(summary).values()
    looked_at = sum(report.windows for report in reports)
    hours = total["hours"]
    numbers = {
        "hours" if hours >= 1 else "minutes": f"{hours:,.1f}" if hours >= 1 else f"{60 * hours:,.1f}",
        "clips": f"{total['clips']:,}",
        "recordings": f"{total['recordings']:,}",
        "speakers": f"{total['speakers']:,}",
        "windows": f"{total['windows']:,}",
        "words per minute": None if not total["words"] else f"{total['words_per_minute']:.0f}",
        "of the windows kept": f"{sum(report.kept for report in reports) / looked_at:.0%}" if looked_at else None,
        "of the frames show both hands": None if total["both_hands"] is None else f"{total['both_hands']:.0%}",
    }
    items = (f"<li><b>{value}</b> <span>{name}</span></li>" for name, value in numbers.items() if value is not None)
    return f'<ul class="numbers">{"".join(items)}</ul>'


def _samples(corpus: Corpus, count: int) -> Iterator[str]:
    chosen = _choose(corpus, count)
    if chosen:
        yield "<h2>Clips</h2><p class='quiet'>The stored joints, drawn as a figure, with the speech.</p>"
        figures = [
            _figure(corpus, split, index)
            for split, index in tqdm(chosen, desc="Sample clips", unit="clip", leave=False, disable=None)
        ]
        yield f'<div class="clips">{"".join(figures)}</div>'


def _choose(corpus: Corpus, count: int) -> list[tuple[str, int]]:
    """Choose clips evenly over the first split that has any, each the next one of a speaker who is not shown yet."""
    split = next((split for split in corpus.splits if corpus.has_clips(split)), None)
    if split is None:
        return []
    clips = corpus.clips(split)
    chosen: list[int] = []
    speakers: set[str] = set()
    for number in range(min(count, len(clips))):
        first = number * len(clips) // min(count, len(clips))
        candidates = [index for index in range(first, min(first + _LOOK_AHEAD, len(clips))) if index not in chosen]
        known = {index: clips.fields(index)["speaker"] for index in candidates}
        index = next((index for index, speaker in known.items() if speaker not in speakers), first)
        if index not in chosen:
            chosen.append(index)
            speakers.add(known[index])
    return [(split, index) for index in chosen]


def _figure(corpus: Corpus, split: str, index: int) -> str:
    """Make a video of a clip, from its first window on."""
    clip = corpus.clips(split)[index]
    start = min((start for start in clip.window_starts if 0 <= start < len(clip.positions)), default=0)
    end = min(start + round(_SAMPLE_SECONDS * corpus.fps), len(clip.positions))
    directions = positions_to_directions(corpus.skeleton, clip.positions[start:end])
    motion = Motion.from_directions(corpus.skeleton, directions, corpus.fps)
    audio = clip.audio[round(start / corpus.fps * SAMPLE_RATE) : round(end / corpus.fps * SAMPLE_RATE)]
    with tempfile.TemporaryDirectory() as folder:
        video = pathlib.Path(folder) / "clip.mp4"
        write_video(video, motion, audio, size=_SAMPLE_SIZE, has_progress=False)
        data = _base64(video.read_bytes())
    name, speaker = html.escape(clip.id), html.escape(clip.speaker)
    words = html.escape(_words(clip, start / corpus.fps, end / corpus.fps))
    return (
        f'<figure><video controls preload="none" aria-label="Clip {name}, speaker {speaker}" '
        f'poster="data:image/jpeg;base64,{_poster(motion)}" src="data:video/mp4;base64,{data}"></video>'
        f"<figcaption><b>{name}</b> of {html.escape(split)}, speaker {speaker}"
        f"{f'<br>“{words}”' if words else ''}</figcaption></figure>"
    )


def _poster(motion: Motion) -> str:
    """Draw the middle frame, which is shown until the video plays."""
    view = fit([(motion.positions, motion.skeleton)])
    middle = motion.positions[motion.num_frames // 2]
    image = draw_figure(middle, motion.skeleton, DEFAULT_LOOK, _SAMPLE_SIZE, _SAMPLE_SIZE, view)
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=80)
    return _base64(buffer.getvalue())


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _words(clip: Clip, start: float, end: float) -> str:
    words = [word.text for word in clip.words if start <= word.start < end]
    return " ".join(words[:_MAX_WORDS]) + (" ..." if len(words) > _MAX_WORDS else "")


def _import(summary: dict[str, Any]) -> Iterator[str]:
    """Make the section on the import: what was kept and left out."""
    if not summary["import"]:
        return
    yield "<h2>Import</h2>"
    for split, report in report_of(summary).items():
        yield (
            f"<h3>{html.escape(split)}: {report.windows:,} windows of {report.clips:,} clips of "
            f"{report.videos:,} recordings</h3>"
        )
        yield from _losses(report)
    failed = summary["failed"]
    if failed:
        rows = [["recording that failed", "reason"]]
        rows += [[str(one.get("video")), str(one.get("reason"))] for one in failed[:_MAX_FAILURES]]
        yield f"<h3>{len(failed):,} recordings failed</h3>" + table(rows)


def _losses(report: SplitReport) -> Iterator[str]:
    if report.windows:
        filtered = {_REASONS.get(reason, reason): count for reason, count in report.filtered.items()}
        yield fractions({"kept": report.kept, **filtered}, good="kept")
    if report.rejected:
        rest = max(report.clips - report.rejected.total(), 0)
        yield f"<p class='quiet'>Of the {report.clips:,} clips:</p>"
        yield fractions({"have windows that were kept": rest, **report.rejected}, good="have windows that were kept")


def _speech(summary: dict[str, Any]) -> Iterator[str]:
    charted = {
        "Words per minute, by clip": ("clip_pace", PACE_EDGES, "", range(0, 401, 100)),
        "Length of a clip": ("clip_seconds", SECONDS_EDGES, " s", range(0, 61, 10)),
    }
    figures = [
        f"<figure>{histogram(summary[key], edges, unit=unit, label=title, ticks=ticks)}"
        f"<figcaption>{title}</figcaption></figure>"
        for title, (key, edges, unit, ticks) in charted.items()
        if sum(summary[key])
    ]
    yield f'<h2>Speech and clips</h2><div class="grid2">{"".join(figures)}</div>'


def _motion(summary: dict[str, Any]) -> Iterator[str]:
    """Make the section on motion: angles and bones of the training split beside the published ones."""
    training = summary["training"]
    if training is None:
        return
    has_table = any("table_10" in angle for angle in training["joints"].values())
    yield f"<h2>Motion</h2><p>{training['frames']:,} frames of the training split that lie in a window.</p>"
    yield "<h3>Inner angles of shoulders and elbows</h3>" + _key(has_table)
    figures = []
    for joint, angle in training["joints"].items():
        curves = {"published": angle["published"], **({"paper": angle["table_10"]} if has_table else {})}
        label = f"{joint.replace('_', ' ')}: {angle['corpus']['mean']:.1f} ± {angle['corpus']['std']:.1f} degrees"
        chart = histogram(
            angle["histogram"],
            ANGLE_EDGES,
            unit="°",
            label=f"Inner angle, {label}",
            curves={name: (curve["mean"], curve["std"]) for name, curve in curves.items()},
            ticks=range(0, 181, 30),
        )
        figures.append(f"<figure>{chart}<figcaption>{label}</figcaption></figure>")
    yield f'<div class="grid2">{"".join(figures)}</div>' + table(joint_rows(training))
    rows = {
        name: {
            "corpus": (angle["mean"], angle["std"]),
            "published": (angle["published_mean"], angle["published_std"]),
        }
        for name, angle in training["angles"].items()
    }
    label = "Mean and standard deviation of the angle between two bones"
    yield (
        f"<details><summary>All {len(rows)} angles of the physical loss</summary>"
        f'<ul class="key"><li><i></i>this corpus</li><li><i class="published plain"></i>published</li></ul>'
        f"<div class='wide'>{ranges(rows, unit='°', label=label, high=180)}</div>"
        f"{table(angle_rows(training))}</details>"
        f"<details><summary>Bone lengths</summary>{table(bone_rows(training))}</details>"
    )
    speed = training["wrist_speed"]
    chart = histogram(speed["histogram"], SPEED_EDGES, unit=" m/s", label="Speed of the wrists", ticks=range(5))
    yield (
        f"<h3>Speed of the wrists</h3><figure class='half'>{chart}<figcaption>{speed['mean']:.2f} m/s on average, "
        f"{speed['median']:.2f} in the median, {speed['percentile_95']:.2f} at 95 %</figcaption></figure>"
    )


def _key(has_table: bool) -> str:
    paper = '<li><i class="paper"></i>Table 10 of the paper</li>' if has_table else ""
    note = (
        "<p class='quiet'>Table 10 gives a mean and a “var (°)” for TED-Expressive; the second is drawn as a standard "
        "deviation. The statistics that were published with the data differ.</p>"
    )
    return (
        '<ul class="key"><li><i class="bars"></i>this corpus</li>'
        f'<li><i class="published"></i>published statistics of the skeleton</li>{paper}</ul>{note if has_table else ""}'
    )
