"""Key frames of a motion, and figures of them: several motions at the same moments, one below the other (Figure 2)."""

import html
import io
import itertools
import pathlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.figure import DEFAULT_LOOK, Colour, View, draw_figure, fit, outline
from ha2g_jax.figure.lettering import font_for
from ha2g_jax.figure.shapes import shade, to_hex
from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import Skeleton

MAX_COUNT = 100
MIN_SIZE, MAX_SIZE = 64, 2048

_SMOOTHING = 0.2  # seconds; the positions of tracked and generated hands jitter
_LEAST_PROMINENCE = 0.03  # metres per second by which a stroke is faster than the motion around it
_MARGIN = 0.1  # fraction of a span that is left out at both ends, so that two key frames are not adjacent
_GAP = 6  # pixels between pictures
_MOST_LINES = 3  # lines of words under a picture
_NEAR = 1.0  # words within this many seconds of a frame are shown
_INK, _GREY = (30, 34, 42), (140, 146, 156)
_PAPER = (255, 255, 255)


def choose(motion: Motion, count: int) -> list[int]:
    """Choose key frames: frames at the peak of a stroke or at a hold of the hands.

    Candidates are the maxima and minima of the speed of the wrists, smoothed over 0.2 seconds. The motion is divided
    into `count` equal spans. In each span the candidate is taken at which the wrists are farthest from their rest
    position, which is their median position in the slowest tenth of all frames; in a span without a candidate, the
    frame in the middle.

    Returns:
        Indices of `count` different frames in order of time, or of all frames where the motion has fewer.
    """
    from scipy import signal  # imported here because it takes a second, which an error need not wait for

    if motion.num_frames <= count:
        return list(range(motion.num_frames))
    wrists = _wrists(motion)
    speed = _speed(wrists, motion.fps)
    rest = np.median(wrists[speed <= np.quantile(speed, 0.1)], axis=0)
    reach = np.linalg.norm(wrists - rest, axis=-1).sum(axis=-1)
    peaks, _ = signal.find_peaks(speed, prominence=_LEAST_PROMINENCE)
    holds, _ = signal.find_peaks(-speed, prominence=_LEAST_PROMINENCE)
    moments = np.union1d(peaks, holds)
    borders = [motion.num_frames * part // count for part in range(count + 1)]
    return [_choose_in_span(moments, reach, start, end) for start, end in itertools.pairwise(borders)]


def write(
    path: str | pathlib.Path,
    motion: Motion | Mapping[str, Motion],
    *,
    count: int = 8,
    words: Sequence[Word] = (),
    size: int = 240,
) -> None:
    """Write a figure of key frames as `.png` or `.svg`, with one row for each motion and one column for each moment.

    The moments are those of `choose` in the first motion; the other motions are shown at the same times. One camera
    shows all of them at one size, far enough away for every frame of all motions. Below each column are the time and
    the words. The word that is spoken at the moment is dark; words up to a second before or after it are grey. The same
    input gives the same bytes.

    Args:
        motion: one motion, or several by name; the name is written above the row.
        size: width and height of each picture in pixels.

    Raises:
        UserError: the suffix is another, the count or the size is out of range, a motion is not valid (see
            `Motion.check`), or the file cannot be written.
    """
    path = pathlib.Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".png", ".svg"):
        raise UserError(
            f"key frames are written as .png or .svg, not {suffix or 'without a suffix'}; rename {path.name}"
        )
    if not 1 <= count <= MAX_COUNT:
        raise UserError(f"{count} key frames; expected 1 to {MAX_COUNT}")
    if not MIN_SIZE <= size <= MAX_SIZE:
        raise UserError(f"pictures of {size} pixels; expected {MIN_SIZE} to {MAX_SIZE}")
    motions = motion if isinstance(motion, Mapping) else {"": motion}
    for each in motions.values():
        each.check()
    first = next(iter(motions.values()))
    times = [frame / first.fps for frame in choose(first, count)]
    page = _page(motions, times, words, size)
    content = _as_png(page) if suffix == ".png" else "".join(f"{line}\n" for line in _svg_lines(page)).encode()
    with whole_file(path) as temporary:
        temporary.write_bytes(content)


class _Text(NamedTuple):
    """One line of words with their colours; `x` is its start or its middle, and `y` its baseline, in pixels."""

    x: float
    y: float
    words: tuple[tuple[str, Colour], ...]
    size: float
    anchor: Literal["start", "middle"] = "start"


class _Page(NamedTuple):
    """A page of square pictures of `size` pixels: left and upper edge, positions (joints, 3) and skeleton of each."""

    width: int
    height: int
    size: int
    view: View
    pictures: tuple[tuple[int, int, np.ndarray, Skeleton], ...]
    texts: tuple[_Text, ...]


def _wrists(motion: Motion) -> np.ndarray:
    joints = [motion.joint_names.index(f"{side}_wrist") for side in ("left", "right")]
    return motion.positions[:, joints].astype(np.float64)


def _speed(wrists: np.ndarray, fps: float) -> np.ndarray:
    """Return the (T,) smoothed sum of the speeds of both wrists in metres per second."""
    speed = np.linalg.norm(np.gradient(wrists, axis=0) * fps, axis=-1).sum(axis=-1)
    window = np.hanning(2 * round(_SMOOTHING * fps / 2) + 3)
    padded = np.pad(speed, len(window) // 2, mode="edge")
    return np.convolve(padded, window / window.sum(), mode="valid")


def _choose_in_span(moments: np.ndarray, reach: np.ndarray, start: int, end: int) -> int:
    """Return the moment of the largest reach inside a span of frames and away from its ends, or else the middle."""
    margin = _MARGIN * (end - start)
    inside = moments[(moments >= start + margin) & (moments < end - margin)]
    return int(inside[np.argmax(reach[inside])]) if len(inside) else (start + end) // 2


def _page(motions: Mapping[str, Motion], times: Sequence[float], words: Sequence[Word], size: int) -> _Page:
    letter = size / 14
    line, step = round(1.4 * letter), size + _GAP
    pictures, texts, y = [], [], _GAP
    for name, motion in motions.items():
        if name:
            texts.append(_Text(_GAP, y + letter, ((name, _INK),), letter))
            y += line
        for column, time in enumerate(times):
            frame = min(round(time * motion.fps), motion.num_frames - 1)
            pictures.append((_GAP + column * step, y, motion.positions[frame], motion.skeleton))
        y += step
    y += round(letter)
    lines = 0
    for column, time in enumerate(times):
        middle = _GAP + column * step + size / 2
        texts.append(_Text(middle, y, ((f"{time:.2f} s", _GREY),), 0.85 * letter, "middle"))
        spoken = list(_lines(_words_near(words, times, column), size, letter))
        lines = max(lines, len(spoken))
        for number, row in enumerate(spoken, start=1):
            coloured = tuple((word.text, _INK if word.start <= time < word.end else _GREY) for word in row)
            texts.append(_Text(middle, y + number * line, coloured, letter, "middle"))
    view = fit((motion.positions, motion.skeleton) for motion in motions.values())
    width, height = _GAP + len(times) * step, y + lines * line + line // 2
    return _Page(width, height, size, view, tuple(pictures), tuple(texts))


def _words_near(words: Sequence[Word], times: Sequence[float], column: int) -> list[Word]:
    """Return the words within a second of the moment of a column that are nearer to it than to another column's."""
    time = times[column]
    start = max(time - _NEAR, (times[column - 1] + time) / 2 if column else 0)
    end = min(time + _NEAR, (time + times[column + 1]) / 2 if column + 1 < len(times) else np.inf)
    middles = ((word, (word.start + word.end) / 2) for word in words)
    return [word for word, middle in middles if start <= middle < end or word.start <= time < word.end]


def _lines(words: Sequence[Word], width: float, letter: float) -> Iterator[list[Word]]:
    """Break words into lines of a width in pixels; words that do not fit in three lines are left out."""
    font = font_for("".join(word.text for word in words), letter)
    row: list[Word] = []
    rows = 0
    for word in words:
        if row and font.getlength(" ".join(each.text for each in [*row, word])) > width:
            yield row
            row, rows = [], rows + 1
            if rows == _MOST_LINES:
                return
        row.append(word)
    if row:
        yield row


def _as_png(page: _Page) -> bytes:
    image = Image.new("RGB", (page.width, page.height), _PAPER)
    for x, y, positions, skeleton in page.pictures:
        pixels = draw_figure(positions, skeleton, DEFAULT_LOOK, page.size, page.size, page.view)
        image.paste(Image.fromarray(pixels), (x, y))
    pen = ImageDraw.Draw(image)
    for text in page.texts:
        line = " ".join(word for word, _ in text.words)
        font = font_for(line, text.size)
        width = font.getlength(line)
        x = text.x - width / 2 if text.anchor == "middle" else text.x
        for word, colour in text.words:
            pen.text((x, text.y), word, fill=colour, font=font, anchor="ls")
            x += font.getlength(f"{word} ")
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def _svg_lines(page: _Page) -> Iterator[str]:
    """Yield the lines of an SVG document whose texts remain texts."""
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{page.width}" height="{page.height}" '
        f'viewBox="0 0 {page.width} {page.height}" font-family="Helvetica, Arial, sans-serif">'
    )
    yield f'<rect width="100%" height="100%" fill="{to_hex(_PAPER)}"/>'
    yield '<radialGradient id="light0" cx="50%" cy="37.5%" r="75%">'  # approximates `shapes.backdrop`
    for offset, light in ((0, 1.05), (0.5, 1.0), (1, 0.85)):
        yield f'<stop offset="{offset}" stop-color="{to_hex(shade(DEFAULT_LOOK.background, light))}"/>'
    yield "</radialGradient>"
    scale, spine = page.view.place(page.size, page.size)
    for x, y, positions, skeleton in page.pictures:
        figure = outline(positions[None], skeleton, DEFAULT_LOOK, detail=2)
        points = figure.points[0] * scale + spine
        yield f'<svg x="{x}" y="{y}" width="{page.size}" height="{page.size}">'
        yield '<rect width="100%" height="100%" fill="url(#light0)"/>'
        for shape in figure.order[0].tolist():
            corners = points[figure.ends[shape] : figure.ends[shape + 1]]
            path = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners.tolist())
            yield f'<polygon points="{path}" fill="{to_hex(figure.colours[shape])}"/>'
        yield "</svg>"
    for text in page.texts:
        place = f'x="{text.x:.1f}" y="{text.y:.1f}" font-size="{text.size:g}" text-anchor="{text.anchor}"'
        words = (f'<tspan fill="{to_hex(colour)}">{html.escape(word)}</tspan>' for word, colour in text.words)
        yield f"<text {place}>{' '.join(words)}</text>"
    yield "</svg>"
