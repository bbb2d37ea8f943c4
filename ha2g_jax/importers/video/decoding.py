"""Decoding of the images of a video within limits of memory."""

import contextlib
import pathlib
from collections.abc import Iterator

import av
from av.container import InputContainer

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import MEDIA_ERRORS, open_media
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.limits import MAX_VIDEO_IMAGE_BYTES, MAX_VIDEO_IMAGES, MAX_VIDEO_PIXELS

_LARGE = 1 << 24  # bytes of an image from which only two are decoded at a time


def open_video(video: pathlib.Path) -> InputContainer:
    """Open a video, which the caller must close.

    Args:
        video: path of a video.

    Raises:
        UserError: the file cannot be read, has no images, or has images that are larger than docs/limits.md states.
    """
    try:
        container = open_media(video)
    except MEDIA_ERRORS as error:
        raise unreadable(video, error) from error
    with contextlib.ExitStack() as on_error:
        on_error.push(container)
        if not container.streams.video:
            raise no_images(video)
        stream = container.streams.video[0]
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
    """Yield the images of a video in the order in which they are shown.

    Args:
        video: path of the video, to name it in an error message.
        container: the open video.

    Raises:
        UserError: an image cannot be read, or there are too many or too large ones.
    """
    try:
        for number, frame in enumerate(container.decode(container.streams.video[0])):
            if number == MAX_VIDEO_IMAGES:
                raise UserError(f"{shown(video)} has more than {MAX_VIDEO_IMAGES} images; cut it into parts of an hour")
            _check_size(video, frame.width, frame.height, frame.format)
            yield frame
    except MEDIA_ERRORS as error:
        raise unreadable(video, error) from error


def no_images(video: pathlib.Path) -> UserError:
    """Return the error of a file without images.

    Args:
        video: path of the file.
    """
    return UserError(f"{shown(video)} has no images; expected a video of a speaker")


def unreadable(video: pathlib.Path, error: Exception) -> UserError:
    """Return the error of a file that cannot be decoded.

    Args:
        video: path of the file.
        error: exception of FFmpeg.
    """
    why = reason(error).lower()
    return UserError(f"{shown(video)} is not a readable video ({why}); expected a complete file with images and audio")


def _check_size(video: pathlib.Path, width: int, height: int, layout: av.VideoFormat | None) -> int:
    """Return the number of bytes of a decoded image."""
    parts = layout.components if layout is not None else ()
    num_bytes = sum(-(-part.bits // 8) * part.width * part.height for part in parts)
    if width * height > MAX_VIDEO_PIXELS or num_bytes > MAX_VIDEO_IMAGE_BYTES:
        raise UserError(
            f"{shown(video)} has images of {width} x {height} and {num_bytes} bytes; expected at most "
            f"{MAX_VIDEO_PIXELS} pixels, such as 7680 x 4320, and {MAX_VIDEO_IMAGE_BYTES} bytes; reduce their size"
        )
    return num_bytes
