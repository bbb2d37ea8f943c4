"""The images of a video: decoding within limits of memory, their times, and squares around the speaker."""

import contextlib
import fractions
import pathlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import av
import numpy as np
from av.container import InputContainer
from PIL import Image

from ha2g_jax.errors import UserError
from ha2g_jax.features.media import MEDIA_ERRORS, open_media, sound_start, video_track
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.limits import MAX_VIDEO_IMAGE_BYTES, MAX_VIDEO_IMAGES, MAX_VIDEO_PIXELS
from ha2g_jax.skeleton import Skeleton

_MARGIN = 1.15  # enlargement of the square around the keypoints, because shoulders and fingertips lie outside them
_CROWN = 1.3  # distance of the top of the hair from the nose, as a multiple of that of the neck
DEFAULT_RATE = 25
_WHOLE = 0.9  # fraction of the stated length, less a second, that must exist, because stated lengths are imprecise

_NARROWEST = 1 / 4  # width of a pixel as a multiple of its height; beyond it, and its inverse, a header is wrong

_LARGE = 1 << 24  # bytes of an image from which only two are decoded at a time


class Box(NamedTuple):
    """A square in an image, in pixels; it may extend beyond the edges of the image."""

    left: int
    top: int
    side: int


def open_video(video: pathlib.Path) -> InputContainer:
    """Open a video, which the caller must close.

    Raises:
        UserError: the file cannot be read, has no images, or has images that are larger than docs/limits.md states.
    """
    try:
        container = open_media(video)
    except MEDIA_ERRORS as error:
        raise _unreadable(video, error) from error
    with contextlib.ExitStack() as on_error:
        on_error.push(container)
        if (stream := video_track(container)) is None:
            raise no_images(video)
        if stream.codec_context is None:
            raise UserError(f"{shown(video)} has images of an unknown codec; expected a usual one, such as H.264")
        num_bytes = _check_size(video, stream.width, stream.height, stream.format)
        on_error.pop_all()
    stream.codec_context.options = {"max_pixels": str(MAX_VIDEO_PIXELS)}
    stream.thread_type = "AUTO"
    if num_bytes > _LARGE:
        stream.codec_context.thread_count = 2
    return container


def decode(video: pathlib.Path, container: InputContainer) -> Iterator[av.VideoFrame]:
    """Yield the images of an open video in the order in which they are shown.

    Raises:
        UserError: an image cannot be read, or there are too many or too large ones.
    """
    try:
        for number, frame in enumerate(container.decode(_track(container))):
            if number == MAX_VIDEO_IMAGES:
                raise UserError(f"{shown(video)} has more than {MAX_VIDEO_IMAGES} images; cut it into parts of an hour")
            _check_size(video, frame.width, frame.height, frame.format)
            yield frame
    except MEDIA_ERRORS as error:
        raise _unreadable(video, error) from error


def image_times(video: pathlib.Path) -> np.ndarray:
    """Return the (T,) seconds from the start of its audio at which the images of a video are shown, strictly
    increasing.

    If times are missing or not increasing, they are replaced by those of a constant rate.

    Raises:
        UserError: the file has no readable images, or was cut off.
    """
    times, last = [], 0.0
    with open_video(video) as container:
        rate = float(image_rate(container))
        for frame in decode(video, container):
            times.append(frame.time)
            last = float((frame.duration or 0) * (frame.time_base or 0))
        expected = _stated_seconds(container)
    if not times:
        raise no_images(video)
    if times[0] is not None and times[-1] is not None and (found := times[-1] - times[0] + last) < expected:
        raise UserError(
            f"{shown(video)} was cut off: it has {found:.1f} s of images but declares more; get the whole file"
        )
    try:
        start = sound_start(video)
    except MEDIA_ERRORS as error:
        raise _unreadable(video, error) from error
    stated = np.array([time for time in times if time is not None])
    if len(stated) == len(times) and (np.diff(stated) > 0).all():
        return stated - start
    return (stated[0] if len(stated) else start) - start + np.arange(len(times)) / rate


def image_size(video: pathlib.Path) -> tuple[int, int]:
    """Return the width and height of a video's first image, as it is shown, in pixels."""
    with open_video(video) as container:
        for frame in decode(video, container):
            return upright(frame, pixel_ratio(container)).size
    raise no_images(video)


def speaker_box(points: np.ndarray, skeleton: Skeleton, width: int, height: int) -> Box:
    """Find the square around head, shoulders and hands, (M, joints, 2) pixels or NaN where unseen, in several images.

    It is moved into the image as far as possible. It is the middle of the image if no joint was seen.
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
    """Crop squares from images of a video by number, and resize them to (size, size, 3) uint8, black outside the image.

    Raises:
        UserError: an image cannot be read.
    """
    numbers: dict[int, list[int]] = {}
    for number, (frame, _) in enumerate(wanted):
        numbers.setdefault(frame, []).append(number)
    images: dict[int, np.ndarray] = {}
    with open_video(video) as container:
        ratio = pixel_ratio(container)
        for index, frame in enumerate(decode(video, container)):
            if index not in numbers:
                continue
            image = upright(frame, ratio)
            for number in numbers[index]:
                left, top, side = wanted[number][1]
                square = image.crop((left, top, left + side, top + side))
                images[number] = np.asarray(square.resize((size, size), Image.Resampling.LANCZOS))
            if len(images) == len(wanted):
                break
        else:
            if wanted:
                raise UserError(f"{shown(video)} has no image {max(numbers)}, which was there before; check the file")
    return [images[number] for number in range(len(wanted))]


def image_rate(container: InputContainer) -> fractions.Fraction:
    """Return the mean number of images per second that an open video states, or else an assumed one."""
    stream = _track(container)
    return fractions.Fraction(stream.average_rate or stream.guessed_rate or DEFAULT_RATE)


def pixel_ratio(container: InputContainer) -> float:
    """Return the width of a pixel of an open video as a multiple of its height: 4/3 in HDV, 1 in most videos."""
    ratio = float(_track(container).sample_aspect_ratio or 1)
    return ratio if _NARROWEST <= ratio <= 1 / _NARROWEST else 1.0


def upright(frame: av.VideoFrame, pixel_ratio: float) -> Image.Image:
    """Convert a decoded image as players show it, with square pixels and the rotation that phones store beside it."""
    image = Image.fromarray(frame.to_ndarray(format="rgb24"))
    if pixel_ratio != 1:
        image = image.resize((round(image.width * pixel_ratio), image.height), Image.Resampling.BILINEAR)
    return image.rotate(frame.rotation, expand=True) if frame.rotation else image


def _inside(middle: float, side: int, size: int) -> int:
    """Return the start of a stretch of length `side` around `middle`, moved into [0, size] if it fits."""
    start = round(middle - side / 2)
    return min(max(start, 0), size - side) if side <= size else (size - side) // 2


def _stated_seconds(container: InputContainer) -> float:
    """Return the minimum duration of the images of a complete file, negative if the file does not declare it.

    It is the shorter duration of file and stream, because either may include parts that were cut away, or the audio.
    """
    stream = _track(container)
    of_stream = float((stream.duration or 0) * (stream.time_base or 0))
    return _WHOLE * min((container.duration or 0) / av.time_base, of_stream) - 1


def _track(container: InputContainer) -> av.VideoStream:
    """Return the images of a video that `open_video` has checked."""
    stream = video_track(container)
    assert stream is not None
    return stream


def no_images(video: pathlib.Path) -> UserError:
    return UserError(f"{shown(video)} has no images; expected a video of a speaker")


def _unreadable(video: pathlib.Path, error: Exception) -> UserError:
    why = reason(error).lower()
    return UserError(f"{shown(video)} is not a readable video ({why}); expected a complete file with images and audio")


def _check_size(video: pathlib.Path, width: int, height: int, layout: av.VideoFormat | None) -> int:
    parts = layout.components if layout is not None else ()
    num_bytes = sum(-(-part.bits // 8) * part.width * part.height for part in parts)
    if width * height > MAX_VIDEO_PIXELS or num_bytes > MAX_VIDEO_IMAGE_BYTES:
        raise UserError(
            f"{shown(video)} has images of {width} x {height} and {num_bytes} bytes; expected at most "
            f"{MAX_VIDEO_PIXELS} pixels, such as 7680 x 4320, and {MAX_VIDEO_IMAGE_BYTES} bytes; reduce their size"
        )
    return num_bytes
