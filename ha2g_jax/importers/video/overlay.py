"""Copies of videos with the skeleton drawn on the speaker, to check the poses."""

import contextlib
import fractions
import itertools
import pathlib
from collections.abc import Iterator

import av
import numpy as np
from av.container import OutputContainer
from av.error import FFmpegError
from PIL import Image, ImageDraw

from ha2g_jax.errors import UserError
from ha2g_jax.features.media import MEDIA_ERRORS, open_media, sound_track
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.files.writing import whole_file
from ha2g_jax.importers.video.images import decode, open_video, pixel_ratio, upright
from ha2g_jax.skeleton import Skeleton, load_skeleton

# One thread, because videos are processed in parallel, one on each core.
_ENCODER = {"preset": "veryfast", "crf": "23", "threads": "1"}
_LONGEST_SIDE = 1280  # pixels; larger images are reduced
_TIME_BASE = fractions.Fraction(1, 90000)
# Sample rates of AAC.
_SOUND_RATES = (96000, 88200, 64000, 48000, 44100, 32000, 24000, 22050, 16000, 12000, 11025, 8000)

_COLOURS = {"left": (255, 140, 0), "right": (0, 170, 255), "": (90, 230, 90)}
_EDGE, _GREY = (20, 20, 20), np.array([128, 128, 128])
# Fractions of the longer side of the image.
_BODY_WIDTH, _FINGER_WIDTH = 1 / 250, 1 / 600


def write_overlay(
    path: str | pathlib.Path, video: pathlib.Path, times: np.ndarray, image_points: np.ndarray, confidence: np.ndarray
) -> None:
    """Write a copy of a video as mp4 (H.264 and AAC) with the bones drawn on its images, and its audio.

    The person's left is orange, the right blue, the middle green. A bone is drawn if both its ends, (T, 43, 2) pixels,
    are seen; bones of less confidence (T, 43) are greyer. `times` (T,) are those of `images.image_times`. The file is
    written atomically.

    Raises:
        UserError: the video cannot be read, or the file cannot be written.
    """
    start = max(0.0, -float(times[0]))  # start of the audio in seconds, if there are images before it
    options = {"movflags": "faststart", "fflags": "+bitexact"}
    with (
        _named(video),
        whole_file(path) as temporary,
        av.open(f"file:{temporary}", "w", format="mp4", options=options) as container,
    ):
        drawn = _drawn_images(video, image_points, confidence)
        first = next(drawn)
        stream = container.add_stream("libx264", options=_ENCODER)
        stream.width, stream.height, stream.pix_fmt = first.width, first.height, "yuv420p"
        stream.time_base = stream.codec_context.time_base = _TIME_BASE
        sound = _Sound(container, video, start)
        for time, image in zip(times + start, itertools.chain([first], drawn), strict=True):
            frame = av.VideoFrame.from_image(image.resize((stream.width, stream.height)))
            frame.pts, frame.time_base = round(time / _TIME_BASE), _TIME_BASE
            sound.write_until(time)
            container.mux(stream.encode(frame))
        sound.write_until(float("inf"))
        container.mux(stream.encode(None))


@contextlib.contextmanager
def _named(video: pathlib.Path) -> Iterator[None]:
    try:
        yield
    except FFmpegError as error:
        if isinstance(error, OSError):  # such as a full disk
            raise
        raise UserError(f"{shown(video)} has times that no mp4 has ({reason(error).lower()}); convert it") from error


def _drawn_images(video: pathlib.Path, image_points: np.ndarray, confidence: np.ndarray) -> Iterator[Image.Image]:
    """Yield the images of the video with the skeleton, at most 1280 pixels long and with even sides for H.264."""
    skeleton = load_skeleton("ted_expressive")
    with open_video(video) as container:
        ratio = pixel_ratio(container)
        for frame, points, certainty in zip(decode(video, container), image_points, confidence, strict=True):
            image = upright(frame, ratio)
            scale = min(1.0, _LONGEST_SIDE / max(image.size))
            width, height = (max(2, 2 * round(side * scale / 2)) for side in image.size)
            scaled = points * (np.array([width, height]) / image.size)
            image = image.resize((width, height), Image.Resampling.BILINEAR)
            draw_skeleton(image, skeleton, scaled, certainty)
            yield image


def draw_skeleton(image: Image.Image, skeleton: Skeleton, points: np.ndarray, confidence: np.ndarray) -> None:
    """Draw the bones whose ends are both seen: points (joints, 2) in pixels, confidence (joints,), 0 where unseen."""
    draw = ImageDraw.Draw(image)
    is_seen = np.isfinite(points).all(axis=-1) & (confidence > 0)
    # Points far outside are moved closer, because the time of drawing grows with the distance.
    points = np.clip(np.nan_to_num(points), -max(image.size), 2 * max(image.size))
    for parent, child in skeleton.bones:
        if not (is_seen[parent] and is_seen[child]):
            continue
        name = skeleton.joints[child]
        fraction = _FINGER_WIDTH if name.endswith(("_1", "_2", "_3")) else _BODY_WIDTH
        width = max(1, round(fraction * max(image.size)))
        certainty = min(confidence[parent], confidence[child])
        side = name.split("_")[0]
        colour = _GREY + certainty * (np.array(_COLOURS.get(side, _COLOURS[""])) - _GREY)
        ends = [tuple(points[parent].tolist()), tuple(points[child].tolist())]
        draw.line(ends, fill=_EDGE, width=width + 2)
        draw.line(ends, fill=tuple(colour.astype(int).tolist()), width=width)


class _Sound:
    """Copies the audio of a video, if it has any, into another file."""

    def __init__(self, container: OutputContainer, video: pathlib.Path, start: float):
        self._container, self._blocks, self._stream = container, _sound(video), None
        first = next(self._blocks, None)
        if first is None:
            return
        self._rate = first.sample_rate
        self._stream = container.add_stream("aac", rate=self._rate, layout=first.layout.name)
        self._blocks = itertools.chain([first], self._blocks)
        self._written = round(start * self._rate)

    def write_until(self, time: float) -> None:
        """Write the audio before `time` in seconds; infinity writes all of it."""
        if self._stream is None:
            return
        while self._written < time * self._rate:
            block = next(self._blocks, None)
            if block is not None:
                block.pts, block.time_base = self._written, fractions.Fraction(1, self._rate)
                self._written += block.samples
            self._container.mux(self._stream.encode(block))
            if block is None:
                self._stream = None
                return


def _sound(video: pathlib.Path) -> Iterator[av.AudioFrame]:
    """Yield the audio in blocks that AAC accepts: mono or stereo."""
    try:
        with open_media(video) as container:
            if (stream := sound_track(container)) is None:
                return
            rate = next((known for known in _SOUND_RATES if known <= stream.rate), _SOUND_RATES[-1])
            layout = "mono" if stream.channels == 1 else "stereo"
            to_aac = av.AudioResampler(format="fltp", layout=layout, rate=rate)
            for frame in itertools.chain(container.decode(stream), [None]):
                if frame is not None:
                    frame.pts = None
                for block in to_aac.resample(frame):
                    # PyAV gives frames that it need not convert as they are, and later ones of another form, too.
                    if (block.format.name, block.layout.name, block.sample_rate) != ("fltp", layout, rate):
                        raise ValueError("the form of the sound changes")
                    yield block
    except MEDIA_ERRORS as error:
        raise UserError(
            f"{shown(video)} has audio that cannot be read ({reason(error).lower()}); expected a complete file"
        ) from error
