"""Write HTML reports of a corpus: its sizes, import, speech, motion and clips; and the causes of the motion of Talk."""

import base64
import html
import importlib.resources
import io
import os
import pathlib
import re
import string
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage, signal
from tqdm import tqdm

from ha2g_jax import figure
from ha2g_jax.data import recording as filters
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.recording import SplitReport
from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk import teacher
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
    pair_names,
    report_of,
    split_rows,
    summarise,
)
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion.formats.video import write_video
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers.bvh_motion import read_motion
from ha2g_jax.skeleton import (
    Skeleton,
    directions_to_positions,
    joint_angles,
    load_skeleton,
    positions_to_directions,
)

_SAMPLE_SECONDS, _SAMPLE_SIZE = 8, 400
_LOOK_AHEAD = 100  # clips to search for a speaker who is not shown yet
_MAX_WORDS = 40  # words of a sample, written under it
_MAX_FAILURES = 50
_MAX_CAUSED = 200  # clips of Talk whose motion is described
_STILL = 0.1  # m/s; a slower wrist pauses
_STROKE_SPEED, _STROKE_PROMINENCE = 0.15, 0.08  # m/s; minimum height and prominence of a stroke's peak of speed
_STRIPS, _STRIP_FRAMES, _STRIP_STEP, _STRIP_SIZE = 6, 10, 4, 150
_CURVES = {"published": "published", "table_10": "Table 10 of the paper"}
_TABLE_10 = (
    "<p class='quiet'>Table 10 gives a mean and a “var (°)” for TED-Expressive; the second is drawn as a standard "
    "deviation. The statistics that were published with the data differ.</p>"
)
_REASONS = {
    filters.TOO_FEW_WORDS: "too few words",
    filters.MEAN_POSE: "near the mean pose, to which an estimator falls back",
    filters.SPINE_ANGLE: "spine tilted",
    filters.MOTION: "both wrists almost still",
}


def write_report(path: str | os.PathLike, out: str | os.PathLike, *, num_samples: int = 4) -> pathlib.Path:
    """Write a self-contained HTML page with videos. Equal corpora give equal pages.

    Args:
        out: path of the page, an `.html`.
        num_samples: number of clips to watch, of different speakers if possible; 0 for none.

    Returns:
        Path of the page.

    Raises:
        UserError: there is no corpus, a record cannot be used, the page cannot be written, or matplotlib is missing.
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
        "<h2>Splits</h2>" + html_table(split_rows(summary)),
        *_import(summary),
        *_speech(summary),
        *_motion(summary),
    ]
    return _write(out, f"{summary['name']}: corpus report", sections)


def _write(out: pathlib.Path, title: str, sections: Sequence[str]) -> pathlib.Path:
    template = importlib.resources.files("ha2g_jax") / "assets" / "corpus_report.html"
    body = "\n".join(sections)
    page = string.Template(template.read_text()).substitute(title=html.escape(title), body=body)
    with whole_file(out) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return out


def _inline(svg: str) -> str:
    """Return an SVG document as an element of a page, which needs no names of its kind."""
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
    view = figure.fit([(motion.positions, motion.skeleton)])
    middle = motion.positions[motion.num_frames // 2]
    image = figure.draw_figure(middle, motion.skeleton, figure.DEFAULT_LOOK, _SAMPLE_SIZE, _SAMPLE_SIZE, view)
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
        yield f"<h3>{len(failed):,} recordings failed</h3>" + html_table(rows)


def _losses(report: SplitReport) -> Iterator[str]:
    if report.windows:
        filtered = {_REASONS.get(reason, reason): count for reason, count in report.filtered.items()}
        yield _fractions({"kept": report.kept, **filtered}, good="kept")
    if report.rejected:
        rest = max(report.clips - report.rejected.total(), 0)
        yield f"<p class='quiet'>Of the {report.clips:,} clips:</p>"
        yield _fractions({"have windows that were kept": rest, **report.rejected}, good="have windows that were kept")


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


def _motion(summary: dict[str, Any]) -> Iterator[str]:
    """Make the section on motion: angles and bones of the training split beside the published ones."""
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


def write_talk_report(
    path: str | os.PathLike, out: str | os.PathLike, recording: str | os.PathLike | None = None
) -> pathlib.Path:
    """Write a self-contained HTML page that compares the motion of a Talk corpus with TED's angles and a recording.

    Args:
        out: path of the page, whose suffix becomes .html.
        recording: path of a BVH motion capture of a real speaker.

    Returns:
        Path of the page.

    Raises:
        UserError: there is no Talk corpus, the page cannot be written, the recording cannot be read, or matplotlib is
            missing.
    """
    corpus = Corpus.open(path)
    skeleton = load_skeleton(corpus.metadata["skeleton"])
    clips = corpus.clips("train")[:_MAX_CAUSED]
    if corpus.skeleton.name != teacher.SKELETON or not clips or not all(map(_is_of_talk, clips)):
        raise UserError(f"{path} has no styles and strokes; give a corpus made by `ha2g data make-talk`")
    people = {"Talk": kinematics(skeleton, [clip.positions for clip in clips], corpus.fps)}
    if recording is not None:
        people["recording"] = kinematics(skeleton, [_read_recording(recording, skeleton, corpus.fps)], corpus.fps)
    minutes = sum(len(clip.positions) for clip in clips) / corpus.fps / 60
    title = f"{corpus.path.name}: motion and its causes"
    sections = [
        f"<h1>{html.escape(title)}</h1><p>{len(clips)} clips, {minutes:.1f} minutes of the training split. Talk is a "
        "testbed: its numbers say nothing about people.</p>",
        "<h2>Wrists</h2>" + html_table(_motion_rows(people)),
        "<h2>Angles</h2>" + _angles(skeleton, people),
        "<h2>Causes</h2>" + html_table(_stroke_rows(clips, minutes)),
        "<h2>Images</h2>" + _strips(skeleton, clips),
    ]
    return _write(pathlib.Path(out).with_suffix(".html"), title, sections)


def _is_of_talk(clip: Clip) -> bool:
    return len(clip.style) == len(Style._fields) and len(clip.positions) >= _STRIP_FRAMES * _STRIP_STEP


def _read_recording(recording: str | os.PathLike, skeleton: Skeleton, fps: float) -> np.ndarray:
    """Read the recorded motion (T, joints, 3) with the bone lengths of `skeleton`, so that speeds are comparable."""
    positions = read_motion(recording, skeleton, fps=fps).positions
    return directions_to_positions(skeleton, positions_to_directions(skeleton, positions))


class Kinematics(NamedTuple):
    """Kinematics of the two wrists over all clips.

    Attributes:
        speed, acceleration, jerk: (n,) magnitudes in m/s, m/s^2 and m/s^3.
        pauses: (p,) length in seconds of each stretch in which a wrist is slower than 0.1 m/s.
        strokes_per_minute: number of peaks of a wrist's speed per minute, mean of both wrists.
        still: fraction of the time in which a wrist pauses.
        angles: (frames, pairs) angles in degrees.
    """

    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    pauses: np.ndarray
    strokes_per_minute: float
    still: float
    angles: np.ndarray


def kinematics(skeleton: Skeleton, motions: Sequence[np.ndarray], fps: float) -> Kinematics:
    """Compute the kinematics of several motions, positions (T, joints, 3) in metres of at least 4 frames each."""
    wrists = [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]
    derivatives: list[list[np.ndarray]] = [[], [], []]
    pauses, strokes, frames = [], 0.0, 0
    for motion in motions:
        moving = motion[:, wrists].astype(np.float64)
        for order, found in enumerate(derivatives, start=1):
            found.append(np.linalg.norm(np.diff(moving, order, axis=0), axis=-1).ravel() * fps**order)
        speed = np.linalg.norm(np.diff(moving, axis=0), axis=-1) * fps
        smooth = ndimage.convolve1d(speed, [0.25, 0.5, 0.25], axis=0, mode="nearest")
        for wrist in smooth.T:
            peaks, _ = signal.find_peaks(wrist, height=_STROKE_SPEED, prominence=_STROKE_PROMINENCE)
            strokes += len(peaks) / 2
            edges = np.flatnonzero(np.diff(np.concatenate([[0], wrist < _STILL, [0]])))
            pauses += list((edges[1::2] - edges[::2]) / fps)
        frames += len(speed)
    angles = [np.rad2deg(joint_angles(skeleton, positions_to_directions(skeleton, motion))) for motion in motions]
    speed, acceleration, jerk = (np.concatenate(found) for found in derivatives)
    seconds = frames / fps
    still = float(sum(pauses) / (2 * seconds))
    return Kinematics(
        speed, acceleration, jerk, np.array(pauses), strokes / seconds * 60, still, np.concatenate(angles)
    )


def _motion_rows(people: dict[str, Kinematics]) -> list[list[str]]:
    rows = [["", *people]]
    quantities = {"speed, m/s": "speed", "acceleration, m/s²": "acceleration", "jerk, m/s³": "jerk"}
    for title, field in quantities.items():
        for name, statistic in {"mean": np.mean, "median": np.median, "95 %": lambda x: np.percentile(x, 95)}.items():
            rows.append([f"{title}, {name}", *(f"{statistic(getattr(who, field)):.2f}" for who in people.values())])
    rows.append(["strokes per minute and hand", *(f"{who.strokes_per_minute:.0f}" for who in people.values())])
    rows.append(["fraction of time still", *(f"{who.still:.2f}" for who in people.values())])
    medians = (np.median(who.pauses) if len(who.pauses) else 0 for who in people.values())
    return [*rows, ["length of a pause, median, s", *(f"{median:.2f}" for median in medians)]]


def _stroke_rows(clips: Sequence[Clip], minutes: float) -> list[list[str]]:
    kinds = [stroke.kind for clip in clips for stroke in clip.strokes]
    causes = {"beat": "loud syllables", "nod": "pitch accents", "posture": "pauses", "semantic": "words"}
    rows = [["stroke", "cause", "per minute"]]
    return rows + [[kind, cause, f"{kinds.count(kind) / minutes:.1f}"] for kind, cause in causes.items()]


def _angles(skeleton: Skeleton, people: dict[str, Kinematics]) -> str:
    rows = {}
    for number, name in enumerate(pair_names(skeleton)):
        mean, deviation = 180 * skeleton.angle_mean[number], 180 * np.sqrt(skeleton.angle_variance[number])
        rows[name] = {"TED": _deviation(float(mean), float(deviation))}
        for person, found in people.items():
            angles = found.angles[:, number]
            rows[name][person] = _deviation(float(angles.mean()), float(angles.std()))
    note = "<p>BVH has no face; that of the recording is fixed to the head.</p>" if len(people) > 1 else ""
    label = "Mean and standard deviation of the angle between two bones"
    return note + _inline(interval_chart(rows, label=label, axis="degrees"))


def _strips(skeleton: Skeleton, clips: Sequence[Clip]) -> str:
    """Draw poses of a few clips of different speakers, one row per clip."""
    speakers = {clip.speaker: clip for clip in clips if len(clip.positions) >= _STRIP_FRAMES * _STRIP_STEP}
    shown = list(speakers.values())[:_STRIPS]
    view = figure.fit((clip.positions[: _STRIP_FRAMES * _STRIP_STEP], skeleton) for clip in shown)
    rows = []
    for clip in shown:
        look = look_of(Style(*clip.style))
        poses = clip.positions[: _STRIP_FRAMES * _STRIP_STEP : _STRIP_STEP]
        images = [figure.draw_figure(pose, skeleton, look, _STRIP_SIZE, _STRIP_SIZE, view) for pose in poses]
        rows.append(np.concatenate(images, axis=1))
    buffer = io.BytesIO()
    Image.fromarray(np.concatenate(rows, axis=0)).save(buffer, format="PNG", optimize=True)
    label = "Poses of clips of different speakers"
    return f'<img alt="{label}" src="data:image/png;base64,{_base64(buffer.getvalue())}">'
