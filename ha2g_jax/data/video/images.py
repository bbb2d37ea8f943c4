"""The pictures of a video: when each is shown, and the reference frames, which show the speaker."""

import pathlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from PIL import Image

from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import Skeleton

_MARGIN = 1.15  # of the square around the speaker's keypoints: shoulders and fingertips lie outside them
_CROWN = 1.3  # the top of the hair lies so much further above the nose than the neck below it
_DEFAULT_RATE = 25
_WHOLE = 0.9  # of the stated length, less a second, must be there: statements are rough
_MAX_PIXELS = 1 << 26  # of a picture, twice 8K: what a damaged file declares must not fill the memory


class Box(NamedTuple):
    """A square of a picture, in pixels; it may reach over the picture's edges."""

    left: int
    top: int
    side: int


def frame_times(video: pathlib.Path) -> np.ndarray:
    """When each picture is shown.

    Args:
        video: file with pictures and sound.

    Returns:
        (T,) seconds from the first sample of the sound, strictly rising: the clock of `audio.read_audio` and of words.
        Times that the file does not state, or that run backwards, are replaced by those of a constant rate.

    Raises:
        UserError: the file has no pictures that can be read, or was cut off.
    """
    times, shown = [], 0.0
    with open_video(video) as container:
        stream = container.streams.video[0]
        rate = float(stream.average_rate or stream.guessed_rate or _DEFAULT_RATE)
        for frame in decode(video, container):
            times.append(frame.time)
            shown = float((frame.duration or 0) * (frame.time_base or 0))
        expected = _stated_seconds(container)
    if not times:
        raise _empty(video)
    if times[0] is not None and times[-1] is not None and (found := times[-1] - times[0] + shown) < expected:
        raise UserError(f"{video} has {found:.1f} s of pictures, but states more; it was cut off, get the whole file")
    start = _sound_start(video)
    stated = np.array([time for time in times if time is not None])
    if len(stated) == len(times) and (np.diff(stated) > 0).all():
        return stated - start
    return (stated[0] if len(stated) else start) - start + np.arange(len(times)) / rate


def picture_size(video: pathlib.Path) -> tuple[int, int]:
    """Width and height of a video's first picture, as it is shown, in pixels."""
    with open_video(video) as container:
        for frame in decode(video, container):
            return upright(frame).size
    raise _empty(video)


def speaker_box(points: np.ndarray, skeleton: Skeleton, width: int, height: int) -> Box:
    """The square around head, shoulders and hands in some pictures.

    Args:
        points: (M, joints, 2) pixels, NaN where a joint was not seen.
        skeleton: of the joints.
        width, height: of the pictures.

    Returns:
        The square, moved into the picture as far as it goes; the middle of the picture if no joint was seen.
    """
    names = [name for name in skeleton.joints if name not in ("spine", "left_elbow", "right_elbow")]
    nose, neck = points[:, skeleton.joint("nose")], points[:, skeleton.joint("neck")]
    crown = nose + _CROWN * (nose - neck)
    chosen = np.concatenate([points[:, [skeleton.joint(name) for name in names]].reshape(-1, 2), crown])
    chosen = np.clip(chosen[np.isfinite(chosen).all(axis=1)], 0, (width, height))
    if not len(chosen):
        side = min(width, height)
        return Box((width - side) // 2, (height - side) // 2, side)
    low, high = chosen.min(axis=0), chosen.max(axis=0)
    side = max(16, round(float((high - low).max()) * _MARGIN))
    left, top = (_inside(middle, side, size) for middle, size in zip((low + high) / 2, (width, height), strict=True))
    return Box(left, top, side)


def crops(video: pathlib.Path, wanted: Sequence[tuple[int, Box]], size: int) -> list[np.ndarray]:
    """Parts of a video's pictures.

    Args:
        video: the file.
        wanted: (frame, square), in any order.
        size: width and height of what is returned.

    Returns:
        For each wanted one a (size, size, 3) uint8 image; black beyond the picture's edges.

    Raises:
        UserError: a frame cannot be read.
    """
    numbers: dict[int, list[int]] = {}
    for number, (frame, _) in enumerate(wanted):
        numbers.setdefault(frame, []).append(number)
    images: dict[int, np.ndarray] = {}
    with open_video(video) as container:
        for index, frame in enumerate(decode(video, container)):
            if index not in numbers:
                continue
            picture = upright(frame)
            for number in numbers[index]:
                left, top, side = wanted[number][1]
                square = picture.crop((left, top, left + side, top + side))
                images[number] = np.asarray(square.resize((size, size), Image.Resampling.LANCZOS))
            if len(images) == len(wanted):
                break
        else:
            if wanted:
                raise UserError(f"{video} has fewer pictures than frame {max(numbers)}; expected all that were counted")
    return [images[number] for number in range(len(wanted))]


def upright(frame: av.VideoFrame) -> Image.Image:
    """A picture as players show it: turned by the rotation that phones store beside it."""
    picture = Image.fromarray(frame.to_ndarray(format="rgb24"))
    return picture.rotate(frame.rotation, expand=True) if frame.rotation else picture


def _inside(middle: float, side: int, size: int) -> int:
    """Where a stretch of length `side` starts that lies around `middle`, within [0, size] if it fits."""
    start = round(middle - side / 2)
    return min(max(start, 0), size - side) if side <= size else (size - side) // 2


def _sound_start(video: pathlib.Path) -> float:
    with open_video(video) as container:
        if not container.streams.audio:
            return 0.0
        try:
            first = next(container.decode(container.streams.audio[0]), None)
        except (FFmpegError, OSError, ValueError) as error:
            raise _unreadable(video, error) from error
    return (first.time if first else None) or 0.0


def _stated_seconds(container: InputContainer) -> float:
    """What the pictures last at least if the file is whole; negative where it does not say.

    The shorter of what the file and its pictures state: either may count what an edit has cut away, or the sound.
    """
    stream = container.streams.video[0]
    of_pictures = float((stream.duration or 0) * (stream.time_base or 0))
    return _WHOLE * min((container.duration or 0) / av.time_base, of_pictures) - 1


def open_video(video: pathlib.Path) -> InputContainer:
    """A file with pictures; to be closed by the caller.

    Raises:
        UserError: it cannot be read, has no pictures, or has larger ones than memory should hold.
    """
    try:
        container = av.open(str(video))
    except (FFmpegError, OSError, ValueError) as error:
        raise _unreadable(video, error) from error
    if not container.streams.video:
        container.close()
        raise _empty(video)
    stream = container.streams.video[0]
    if stream.width * stream.height > _MAX_PIXELS:
        container.close()
        raise UserError(f"{video} has pictures of {stream.width} x {stream.height}; expected at most 8192 x 8192")
    stream.codec_context.options = {"max_pixels": str(_MAX_PIXELS)}
    stream.thread_type = "AUTO"
    return container


def decode(video: pathlib.Path, container: InputContainer) -> Iterator[av.VideoFrame]:
    """The pictures in the order in which they are shown.

    Raises:
        UserError: one cannot be read.
    """
    try:
        yield from container.decode(container.streams.video[0])
    except (FFmpegError, OSError, ValueError) as error:
        raise _unreadable(video, error) from error


def _empty(video: pathlib.Path) -> UserError:
    return UserError(f"{video} has no pictures; expected a video of a speaker")


def _unreadable(video: pathlib.Path, error: Exception) -> UserError:
    reason = (getattr(error, "strerror", None) or str(error)).lower()
    return UserError(f"{video} is no video that can be read ({reason}); expected a whole file of pictures and sound")
