"""Write the HTML report of a corpus: its sizes, import, speech, motion and clips, and the causes of Talk's motion."""

import base64
import collections
import html
import importlib.resources
import io
import os
import pathlib
import re
import string
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from PIL import Image
from scipy import ndimage, signal

from ha2g_jax import figure
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.recording import (
    MEAN_POSE,
    MOTION,
    OF_CLIPS,
    SPINE_ANGLE,
    TOO_FEW_WORDS,
    SplitReport,
    report_from_json,
)
from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk.speakers import Style, look_of
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.charts import Mark, histogram, html_table, interval_chart
from ha2g_jax.evaluation.corpus_statistics import (
    ANGLE_EDGES,
    PACE_EDGES,
    SECONDS_EDGES,
    SPEED_EDGES,
    angle_rows,
    bone_rows,
    joint_rows,
    split_rows,
    summarise,
)
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import write_text
from ha2g_jax.motion.formats.video import write_video
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import Reading, at_rate, check_reading, read_motion
from ha2g_jax.progress import counted, track
from ha2g_jax.skeleton import (
    Skeleton,
    directions_to_positions,
    joint_angles,
    positions_to_directions,
)

_SAMPLE_SECONDS, _SAMPLE_SIZE = 8, 400
_LOOK_AHEAD = 100  # clips to search for a speaker who is not shown yet
_MAX_WORDS = 40  # words of a sample, written under it
_MAX_FAILURES = 50
_MAX_DESCRIBED = 200  # training clips whose wrists and causes are described
_MIN_FRAMES = 4  # least number of frames of a recording
_STILL = 0.1  # m/s; a slower wrist pauses
_STROKE_SPEED, _STROKE_PROMINENCE = 0.15, 0.08  # m/s; minimum height and prominence of a stroke's peak of speed
_STRIPS, _STRIP_FRAMES, _STRIP_STEP, _STRIP_SIZE = 6, 10, 4, 150
_CURVES = {"published": "published", "table_10": "Table 10 of the paper"}
_TABLE_10 = (
    "<p class='quiet'>Table 10 gives a mean and a “var (°)” for TED-Expressive; the second is drawn as a standard "
    "deviation. The statistics that were published with the data differ.</p>"
)
_REASONS = {
    TOO_FEW_WORDS: "too few words",
    MEAN_POSE: "near the mean pose, to which an estimator falls back",
    SPINE_ANGLE: "spine tilted",
    MOTION: "both wrists almost still",
}


def write_report(
    path: str | os.PathLike,
    out: str | os.PathLike,
    *,
    num_samples: int = 4,
    recording: str | os.PathLike | None = None,
    **reading: Unpack[Reading],
) -> pathlib.Path:
    """Write a self-contained HTML page with videos, and return its path. Equal corpora give equal pages.

    Args:
        out: path of the page, an `.html`.
        num_samples: number of clips to watch, of different speakers if possible; 0 for none.
        recording: path of motion of a real speaker, to compare the motion with, about which `reading` is known.

    Raises:
        UserError: there is no corpus, `num_samples` is negative, a record or the recording cannot be used, the page
            cannot be written, or matplotlib is missing.
    """
    out = pathlib.Path(out)
    if out.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"the report is an HTML page, not {out.name!r}; name it {out.name}.html")
    if num_samples < 0:
        raise UserError(f"{num_samples} clips to watch; expected at least 0")
    corpus = Corpus.open(path)
    recorded = None if recording is None else _read_recording(recording, corpus, reading)
    summary = summarise(path)
    clips = _training(corpus)
    sections = [
        _head(summary),
        _numbers(summary),
        *_samples(corpus, num_samples),
        "<h2>Splits</h2>" + html_table(split_rows(summary)),
        *_import(summary),
        *_speech(summary),
        *_motion(summary, corpus.skeleton, recorded),
        *_wrists(corpus, clips, recorded),
        *_causes(corpus, clips),
    ]
    template = importlib.resources.files("ha2g_jax") / "assets" / "corpus_report.html"
    title = html.escape(f"{summary['name']}: corpus report")
    page = string.Template(template.read_text()).substitute(title=title, body="\n".join(sections))
    write_text(out, page)
    return out


def _read_recording(recording: str | os.PathLike, corpus: Corpus, reading: Reading) -> np.ndarray:
    """Read recorded motion (T, joints, 3) with the bone lengths of a corpus, so that speeds are comparable."""
    check_reading([pathlib.Path(recording)], **reading)
    motion = read_motion(recording, skeleton=corpus.skeleton.name, fps=corpus.fps, **reading)
    positions = at_rate(motion, corpus.fps).positions  # a motion of our own kept its rate
    if len(positions) < _MIN_FRAMES:
        raise UserError(f"{shown(recording)} has {len(positions)} frames; give a longer recording")
    return directions_to_positions(corpus.skeleton, positions_to_directions(corpus.skeleton, positions))


def _inline(svg: str) -> str:
    """Return an SVG document as an element of a page, without its declarations."""
    return re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg)


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
    total, reports = summary["total"], report_from_json(summary["import"]).values()
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
        figures = [_figure(corpus, split, index) for split, index in track(chosen, "drawing clips", "clip")]
        yield f'<div class="clips">{"".join(figures)}</div>'


def _choose(corpus: Corpus, count: int) -> list[tuple[str, int]]:
    """Choose clips evenly over the first split that has any, each of a speaker who is not shown yet, if possible."""
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
        free = [*candidates, *(index for index in range(len(clips)) if index not in chosen)]
        index = next((index for index, speaker in known.items() if speaker not in speakers), free[0])
        chosen.append(index)
        speakers.add(clips.fields(index)["speaker"])
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
    view = figure.fit([(motion.positions, motion.skeleton)])
    middle = motion.positions[motion.num_frames // 2]
    image = figure.draw_figure(middle, motion.skeleton, figure.DEFAULT_LOOK, _SAMPLE_SIZE, _SAMPLE_SIZE, view)
    return _image(image, "JPEG", quality=80)


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
    for split, report in report_from_json(summary["import"]).items():
        yield (
            f"<h3>{html.escape(split)}: {counted(report.windows, 'window')} of {counted(report.clips, 'clip')} of "
            f"{counted(report.videos, 'recording')}</h3>"
        )
        yield from _losses(report)
    failed = summary["failed"]
    if failed:
        rows = [["recording that failed", "reason"]]
        rows += [[str(one.get("video")), str(one.get("reason"))] for one in failed[:_MAX_FAILURES]]
        yield f"<h3>{counted(len(failed), 'recording')} failed</h3>" + html_table(rows)


def _losses(report: SplitReport) -> Iterator[str]:
    if report.windows:
        filtered = {_REASONS.get(reason, reason): count for reason, count in report.filtered.items()}
        yield _fractions({"kept": report.kept, **filtered}, good="kept")
    if report.rejected:
        of_clips = {reason: count for reason, count in report.rejected.items() if reason in OF_CLIPS}
        rest = max(report.clips - sum(of_clips.values()), 0)
        yield f"<p class='quiet'>Of the {report.clips:,} clips:</p>"
        yield _fractions({"have windows that were kept": rest, **of_clips}, good="have windows that were kept")
        others = [
            f"{html.escape(reason)}: {count:,}" for reason, count in report.rejected.items() if reason not in of_clips
        ]
        if others:
            yield f"<p class='quiet'>Shots and recordings left out: {', '.join(others)}</p>"


def _fractions(counts: Mapping[str, int], *, good: str) -> str:
    """Make a table of counts with bars of their fractions of the sum; `good` is the row that is not a loss."""
    whole = max(sum(counts.values()), 1)
    rows = []
    for name, count in counts.items():
        if not count and name != good:
            continue
        kind = "good" if name == good else "bad"
        rows.append(
            f'<tr><th scope="row">{html.escape(name)}</th><td>{count:,}</td><td>{count / whole:.1%}</td>'
            f'<td class="fraction"><span class="{kind}" style="width:{100 * count / whole:.2f}%"></span></td></tr>'
        )
    return f'<table class="fractions"><tbody>{"".join(rows)}</tbody></table>'


def _speech(summary: dict[str, Any]) -> Iterator[str]:
    charted = {
        "Words per minute, by clip": ("clip_pace", PACE_EDGES, "words per minute"),
        "Length of a clip": ("clip_seconds", SECONDS_EDGES, "seconds"),
    }
    figures = [
        f"<figure>{_inline(histogram(summary[key], edges, axis=axis, label=title))}"
        f"<figcaption>{title}</figcaption></figure>"
        for title, (key, edges, axis) in charted.items()
        if sum(summary[key])
    ]
    yield f'<h2>Speech and clips</h2><div class="grid2">{"".join(figures)}</div>'


def _motion(summary: dict[str, Any], skeleton: Skeleton, recorded: np.ndarray | None) -> Iterator[str]:
    """Make the section on motion: angles and bones of training, the published ones, and those of a recording."""
    training = summary["training"]
    if training is None:
        return
    yield f"<h2>Motion</h2><p>{training['frames']:,} frames of the training split that lie in a window.</p>"
    yield "<h3>Inner angles of shoulders and elbows</h3>"
    if any("table_10" in angle for angle in training["joints"].values()):
        yield _TABLE_10
    figures = []
    for joint, angle in training["joints"].items():
        curves = {_CURVES[key]: (angle[key]["mean"], angle[key]["std"]) for key in _CURVES if key in angle}
        label = f"{joint.replace('_', ' ')}: {angle['corpus']['mean']:.1f} ± {angle['corpus']['std']:.1f} degrees"
        chart = histogram(angle["histogram"], ANGLE_EDGES, axis="degrees", label=f"Inner angle, {label}", curves=curves)
        figures.append(f"<figure>{_inline(chart)}<figcaption>{label}</figcaption></figure>")
    yield f'<div class="grid2">{"".join(figures)}</div>' + html_table(joint_rows(training))
    rows = {
        name: {
            title: _deviation(angle[f"{key}mean"], angle[f"{key}std"])
            for title, key in {"this corpus": "", "published": "published_"}.items()
        }
        for name, angle in training["angles"].items()
    }
    if recorded is not None:  # BVH has no face; that of the recording is fixed to the head
        angles = np.rad2deg(joint_angles(skeleton, positions_to_directions(skeleton, recorded)))
        for marks, mean, deviation in zip(rows.values(), angles.mean(axis=0), angles.std(axis=0), strict=True):
            marks["recording"] = _deviation(float(mean), float(deviation))
    label = "Mean and standard deviation of the angle between two bones"
    yield (
        f"<details><summary>All {len(rows)} angles of the physical loss</summary>"
        f"<div class='wide'>{_inline(interval_chart(rows, label=label, axis='degrees'))}</div>"
        f"{html_table(angle_rows(training))}</details>"
        f"<details><summary>Bone lengths</summary>{html_table(bone_rows(training))}</details>"
    )
    speed = training["wrist_speed"]
    chart = _inline(histogram(speed["histogram"], SPEED_EDGES, axis="m/s", label="Speed of the wrists"))
    yield (
        f"<h3>Speed of the wrists</h3><figure class='half'>{chart}<figcaption>{speed['mean']:.2f} m/s on average, "
        f"{speed['median']:.2f} in the median, {speed['percentile_95']:.2f} at 95 %</figcaption></figure>"
    )


def _deviation(mean: float, deviation: float) -> Mark:
    return Mark(mean, mean - deviation, mean + deviation)


def _wrists(corpus: Corpus, clips: Sequence[dict[str, Any]], recorded: np.ndarray | None) -> Iterator[str]:
    """Make the table of how the wrists move in training and in a recording."""
    motions = [fields["positions"] for fields in clips if fields["window_starts"]]
    people = {"this corpus": motions, "recording": [] if recorded is None else [recorded]}
    columns = {name: wrist_motion(corpus.skeleton, each, corpus.fps) for name, each in people.items() if each}
    if columns:
        titles = next(iter(columns.values()))
        rows = [[title, *(f"{column[title]:.2f}" for column in columns.values())] for title in titles]
        yield "<h3>Movement of the wrists</h3>" + html_table([["", *columns], *rows])


def _training(corpus: Corpus) -> list[dict[str, Any]]:
    """Return the fields of the first clips of training; audio and images stay compressed."""
    if not corpus.has_clips(TRAIN):
        return []
    clips = corpus.clips(TRAIN)
    return [clips.fields(index) for index in range(min(len(clips), _MAX_DESCRIBED))]


def wrist_motion(skeleton: Skeleton, motions: Sequence[np.ndarray], fps: float) -> dict[str, float]:
    """Measure how both wrists move in positions (T, joints, 3) in metres, of at least 4 frames each.

    A stroke is a peak of the speed of a wrist; a wrist that is slower than 0.1 m/s pauses.

    Returns:
        Title of each quantity, with its unit -> its value.
    """
    wrists = [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]
    paths = [motion[:, wrists].astype(np.float64) for motion in motions]
    found = {}
    for order, title in enumerate(("speed, m/s", "acceleration, m/s²", "jerk, m/s³"), start=1):
        sizes = [np.linalg.norm(np.diff(path, order, axis=0), axis=-1).ravel() * fps**order for path in paths]
        values = np.concatenate(sizes)
        found |= {f"{title}, mean": values.mean(), f"{title}, median": np.median(values)}
        found[f"{title}, 95 %"] = np.percentile(values, 95)
    pauses, strokes, seconds = [], 0, 0.0  # seconds of each wrist
    for path in paths:
        speed = np.linalg.norm(np.diff(path, axis=0), axis=-1) * fps
        seconds += len(speed) / fps
        for wrist in ndimage.convolve1d(speed, [0.25, 0.5, 0.25], axis=0, mode="nearest").T:
            peaks, _ = signal.find_peaks(wrist, height=_STROKE_SPEED, prominence=_STROKE_PROMINENCE)
            strokes += len(peaks)
            edges = np.flatnonzero(np.diff(np.concatenate([[0], wrist < _STILL, [0]])))
            pauses += list((edges[1::2] - edges[::2]) / fps)
    return found | {
        "strokes per minute and hand": strokes / seconds * 30,
        "fraction of time still": sum(pauses) / (2 * seconds),
        "length of a pause, median, s": np.median(pauses) if pauses else 0.0,
    }


def _causes(corpus: Corpus, clips: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Make the section on what causes the motion of a Talk corpus, and what its speakers look like."""
    if not clips or not all(fields["style"] for fields in clips):
        return
    minutes = sum(len(fields["positions"]) for fields in clips) / corpus.fps / 60
    kinds = collections.Counter(stroke.kind for fields in clips for stroke in fields["strokes"])
    causes = {"beat": "loud syllables", "stance": "phrases", "nod": "pitch accents", "posture": "pauses"}
    causes |= {"semantic": "words"}
    rows = [["stroke", "cause", "per minute"]]
    rows += [[kind, cause, f"{kinds[kind] / minutes:.1f}"] for kind, cause in causes.items()]
    yield (
        f"<h2>Causes</h2><p>Of {len(clips)} clips of the training split. Talk is a testbed: its numbers say nothing "
        f"about people.</p>{html_table(rows)}{_strips(corpus.skeleton, clips)}"
    )


def _strips(skeleton: Skeleton, clips: Sequence[dict[str, Any]]) -> str:
    """Draw poses of a few clips of different speakers, one row per clip."""
    num_frames = _STRIP_FRAMES * _STRIP_STEP
    speakers = {fields["speaker"]: fields for fields in clips if len(fields["positions"]) >= num_frames}
    first = list(speakers.values())[:_STRIPS]
    if not first:
        return ""
    view = figure.fit((fields["positions"][:num_frames], skeleton) for fields in first)
    rows = []
    for fields in first:
        look, poses = look_of(Style(*fields["style"])), fields["positions"][:num_frames:_STRIP_STEP]
        images = [figure.draw_figure(pose, skeleton, look, _STRIP_SIZE, _STRIP_SIZE, view) for pose in poses]
        rows.append(np.concatenate(images, axis=1))
    image = _image(np.concatenate(rows, axis=0), "PNG", optimize=True)
    return f'<img alt="Poses of clips of different speakers" src="data:image/png;base64,{image}">'


def _image(pixels: np.ndarray, kind: str, **options: Any) -> str:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, kind, **options)
    return _base64(buffer.getvalue())
