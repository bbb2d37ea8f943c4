"""HTML report that compares the motion of the Talk corpus with TED's published angles and with a recording."""

import base64
import html
import io
import os
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage, signal, stats

from ha2g_jax import figure
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk import teacher
from ha2g_jax.data.talk.speakers import Style, look_of
from ha2g_jax.errors import UserError
from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion.readers.bvh_motion import read_motion
from ha2g_jax.skeleton import (
    Skeleton,
    directions_to_positions,
    joint_angles,
    load_skeleton,
    positions_to_directions,
)

_MAX_CLIPS = 200
_STILL = 0.1  # m/s; a slower wrist pauses
_STROKE_SPEED, _STROKE_PROMINENCE = 0.15, 0.08  # m/s; minimum height and prominence of a stroke's peak of speed
_SHOWN_PAIRS = (
    "{side}_shoulder - {side}_elbow",
    "{side}_elbow - {side}_wrist",
    "{side}_index_1 - {side}_index_2",
    "{side}_wrist - {side} palm",
)
_STRIPS, _STRIP_FRAMES, _STRIP_STEP, _STRIP_SIZE = 6, 10, 4, 150


class Kinematics(NamedTuple):
    """Kinematics of the two wrists over all clips.

    Attributes:
        speed: (n,) magnitudes in m/s.
        acceleration: (n,) magnitudes in m/s^2.
        jerk: (n,) magnitudes in m/s^3.
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


def write_report(
    corpus_path: str | os.PathLike, out: str | os.PathLike, recording: str | os.PathLike | None = None
) -> pathlib.Path:
    """Write a self-contained HTML page.

    Args:
        corpus_path: folder of a Talk corpus.
        out: path of the page, whose suffix becomes .html.
        recording: path of a BVH motion capture of a real speaker.

    Returns:
        Path of the page.

    Raises:
        UserError: there is no Talk corpus, the page cannot be written, the recording cannot be read, or matplotlib is
            missing.
    """
    pyplot = _pyplot()
    corpus = Corpus.open(corpus_path)
    skeleton = load_skeleton(corpus.metadata["skeleton"])
    clips = corpus.clips("train")[:_MAX_CLIPS]
    if corpus.skeleton.name != teacher.SKELETON or not clips or not all(map(_is_of_talk, clips)):
        raise UserError(f"{corpus_path} has no styles and strokes; give a corpus made by `ha2g data make-talk`")
    people = {"Talk": kinematics(skeleton, [clip.positions for clip in clips], corpus.fps)}
    if recording is not None:
        people["recording"] = kinematics(skeleton, [_read_recording(recording, skeleton, corpus.fps)], corpus.fps)
    sections = [
        f"<p>{len(clips)} clips, {sum(len(clip.positions) for clip in clips) / corpus.fps / 60:.1f} minutes of the "
        "training split. Talk is a testbed: its numbers say nothing about people.</p>",
        "<h2>Wrists</h2>" + _table(_motion_rows(people)) + _histograms(pyplot, people),
        "<h2>Angles</h2>" + _angles(pyplot, skeleton, people) + _angle_histograms(pyplot, skeleton, people),
        "<h2>Causes</h2>" + _table(_stroke_rows(clips, corpus.fps)),
        "<h2>Images</h2>" + _embed(Image.fromarray(_strips(skeleton, clips))),
    ]
    path = pathlib.Path(out).with_suffix(".html")
    page = _PAGE.format(title=html.escape(f"Talk report: {corpus.path.name}"), body="\n".join(sections))
    with whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def _is_of_talk(clip: Clip) -> bool:
    return len(clip.style) == len(Style._fields) and len(clip.positions) >= _STRIP_FRAMES * _STRIP_STEP


def _read_recording(recording: str | os.PathLike, skeleton: Skeleton, fps: float) -> np.ndarray:
    """Read the recorded motion (T, joints, 3) with the bone lengths of `skeleton`, so that speeds are comparable."""
    positions = read_motion(recording, skeleton, fps=fps).positions
    return directions_to_positions(skeleton, positions_to_directions(skeleton, positions))


def kinematics(skeleton: Skeleton, motions: Sequence[np.ndarray], fps: float) -> Kinematics:
    """Compute the kinematics of several motions.

    Args:
        skeleton: skeleton of the motions.
        motions: (T, joints, 3) positions in metres, each of at least 4 frames.
        fps: frames per second.
    """
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


def _stroke_rows(clips: Sequence[Clip], fps: float) -> list[list[str]]:
    minutes = sum(len(clip.positions) for clip in clips) / fps / 60
    kinds = [stroke.kind for clip in clips for stroke in clip.strokes]
    causes = {"beat": "loud syllables", "nod": "pitch accents", "posture": "pauses", "semantic": "words"}
    rows = [["stroke", "cause", "per minute"]]
    return rows + [[kind, cause, f"{kinds.count(kind) / minutes:.1f}"] for kind, cause in causes.items()]


def _histograms(pyplot: Any, people: dict[str, Kinematics]) -> str:
    chart, axes = pyplot.subplots(1, 4, figsize=(14, 3))
    fields = {"speed": "m/s", "acceleration": "m/s²", "jerk": "m/s³", "pauses": "s"}
    for axis, (field, unit) in zip(axes, fields.items(), strict=True):
        values = [getattr(who, field) for who in people.values()]
        top = max(np.percentile(value, 97) if len(value) else 1.0 for value in values)
        for name, value in zip(people, values, strict=True):
            density = len(value) > 0  # a recording without pauses has an empty histogram
            axis.hist(value, bins=np.linspace(0, top, 40), density=density, histtype="step", label=name, linewidth=1.5)
        axis.set(title=field, xlabel=unit, yscale="log")
    axes[0].legend()
    return _save(pyplot, chart)


def _angles(pyplot: Any, skeleton: Skeleton, people: dict[str, Kinematics]) -> str:
    labels = _pair_names(skeleton)
    mean = {"TED": 180 * skeleton.angle_mean} | {name: who.angles.mean(axis=0) for name, who in people.items()}
    spread = {"TED": 180 * np.sqrt(skeleton.angle_variance)}
    spread |= {name: who.angles.std(axis=0) for name, who in people.items()}
    chart, axis = pyplot.subplots(figsize=(14, 4.5))
    for shift, name in enumerate(mean):
        places = np.arange(len(labels)) + 0.25 * (shift - 1)
        axis.errorbar(places, mean[name], spread[name], fmt="o", markersize=3, linewidth=1, label=name)
    axis.set_xticks(range(len(labels)), labels, rotation=90, fontsize=7)
    axis.set(ylabel="degrees, mean and standard deviation")
    axis.legend()
    note = "<p>BVH has no face; that of the recording is fixed to the head.</p>" if len(people) > 1 else ""
    return note + _save(pyplot, chart)


def _pair_names(skeleton: Skeleton) -> list[str]:
    names = [*(skeleton.joints[child] for _, child in skeleton.bones), "left palm", "right palm"]
    return [f"{names[first]} - {names[second]}" for first, second in skeleton.angle_pairs]


def _angle_histograms(pyplot: Any, skeleton: Skeleton, people: dict[str, Kinematics]) -> str:
    """Draw histograms of the most used angles, with the Gaussian of the published mean and variance."""
    names = _pair_names(skeleton)
    chart, axes = pyplot.subplots(2, len(_SHOWN_PAIRS), figsize=(14, 5), sharex="col")
    for column, pair in enumerate(_SHOWN_PAIRS):
        for row, side in enumerate(("left", "right")):
            axis, index = axes[row, column], names.index(pair.format(side=side))
            for name, who in people.items():
                axis.hist(who.angles[:, index], bins=40, density=True, histtype="step", label=name, linewidth=1.5)
            mean, deviation = 180 * skeleton.angle_mean[index], 180 * np.sqrt(skeleton.angle_variance[index])
            degrees = np.linspace(mean - 4 * deviation, mean + 4 * deviation, 200)
            axis.plot(degrees, stats.norm.pdf(degrees, mean, deviation), "k--", linewidth=1, label="TED, as Gaussian")
            axis.set_title(names[index], fontsize=9)
    for axis in axes[1]:
        axis.set_xlabel("degrees")
    axes[0, 0].legend(fontsize=7)
    return _save(pyplot, chart)


def _strips(skeleton: Skeleton, clips: Sequence[Clip]) -> np.ndarray:
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
    return np.concatenate(rows, axis=0)


def _table(rows: list[list[str]]) -> str:
    head, *body = rows
    cells = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
    lines = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in body)
    return f"<table><tr>{cells}</tr>{lines}</table>"


def _save(pyplot: Any, chart: Any) -> str:
    buffer = io.BytesIO()
    chart.savefig(buffer, format="png", dpi=90, bbox_inches="tight")
    pyplot.close(chart)
    return _embed(Image.open(buffer))


def _embed(image: Image.Image) -> str:
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", optimize=True)
    return f'<img src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}">'


def _pyplot() -> Any:
    try:
        import matplotlib
    except ModuleNotFoundError:
        raise UserError("the report needs matplotlib, which is missing; pip install 'ha2g-jax[report]'") from None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 1200px; margin: 2em auto; padding: 0 1em; color: #222 }}
table {{ border-collapse: collapse; margin: 1em 0 }} td, th {{ padding: .2em .9em; border-bottom: 1px solid #ddd }}
td + td, th + th {{ text-align: right }} img {{ max-width: 100% }}
</style></head><body><h1>{title}</h1>
{body}
</body></html>
"""
