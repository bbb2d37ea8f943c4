"""The video with the skeleton drawn on the speaker, to see whether the poses are right."""

import fractions
import itertools
import pathlib
from collections.abc import Iterator

import av
import numpy as np
from av.container import OutputContainer
from av.error import FFmpegError
from PIL import Image, ImageDraw

from ha2g_jax.data.video import frames
from ha2g_jax.errors import UserError
from ha2g_jax.files.whole_file import whole_file
from ha2g_jax.skeleton import Skeleton, load_skeleton

# One thread: videos are worked on side by side, one on each core.
_ENCODER = {"preset": "veryfast", "crf": "23", "threads": "1"}
_LONGEST_SIDE = 1280  # larger pictures are shrunk
_TIME_BASE = fractions.Fraction(1, 90000)
_SOUND_RATES = (96000, 88200, 64000, 48000, 44100, 32000, 24000, 22050, 16000, 12000, 11025, 8000)  # that AAC knows

_COLOURS = {"left": (255, 140, 0), "right": (0, 170, 255), "": (90, 230, 90)}
_EDGE, _GREY = (20, 20, 20), np.array([128, 128, 128])
# As shares of the picture's longer side.
_BODY_WIDTH, _FINGER_WIDTH = 1 / 250, 1 / 600


def write_overlay(
    path: str | pathlib.Path, video: pathlib.Path, image_points: np.ndarray, confidence: np.ndarray
) -> None:
    """Writes an mp4 (H.264 and AAC) of the video's pictures with the bones on them, and its sound.

    The left of the person is orange, the right blue, the middle green. A bone is drawn where both its ends are seen,
    the greyer the less certain. The file is whole or not there.

    Args:
        path: the `.mp4` to write.
        video: the source.
        image_points: (T, 43, 2) pixels, NaN where unseen.
        confidence: (T, 43) in [0, 1], 0 where unseen.

    Raises:
        UserError: the video cannot be read, or the place cannot be written.
    """
    video = pathlib.Path(video)
    times = frames.frame_times(video)
    start = max(0.0, -float(times[0]))  # of the sound, where pictures come before it
    options = {"movflags": "faststart", "fflags": "+bitexact"}
    with whole_file(path) as temporary, av.open(str(temporary), "w", format="mp4", options=options) as container:
        pictures = _pictures(video, image_points, confidence)
        first = next(pictures)
        stream = container.add_stream("libx264", options=_ENCODER)
        stream.width, stream.height, stream.pix_fmt = first.width, first.height, "yuv420p"
        stream.time_base = stream.codec_context.time_base = _TIME_BASE
        sound = _Sound(container, video, start)
        for time, image in zip(times + start, itertools.chain([first], pictures), strict=True):
            frame = av.VideoFrame.from_image(image.resize((stream.width, stream.height)))
            frame.pts, frame.time_base = round(time / _TIME_BASE), _TIME_BASE
            sound.write_until(time)
            container.mux(stream.encode(frame))
        sound.write_until(float("inf"))
        container.mux(stream.encode(None))


def _pictures(video: pathlib.Path, image_points: np.ndarray, confidence: np.ndarray) -> Iterator[Image.Image]:
    """The video's pictures with the skeleton, no larger than is good to look at; sides are even, as H.264 wants."""
    skeleton = load_skeleton("ted_expressive")
    with frames.open_video(video) as source:
        for frame, points, certainty in zip(frames.decode(video, source), image_points, confidence, strict=True):
            image = frames.upright(frame)
            scale = min(1.0, _LONGEST_SIDE / max(image.size))
            width, height = (max(2, 2 * round(side * scale / 2)) for side in image.size)
            scaled = points * (np.array([width, height]) / image.size)
            image = image.resize((width, height), Image.Resampling.BILINEAR)
            draw_skeleton(image, skeleton, scaled, certainty)
            yield image


def draw_skeleton(image: Image.Image, skeleton: Skeleton, points: np.ndarray, confidence: np.ndarray) -> None:
    """Draws the bones whose ends are both seen.

    Args:
        image: is drawn upon.
        skeleton: of the points.
        points: (joints, 2) pixels, NaN where unseen.
        confidence: (joints,) in [0, 1], 0 where unseen.
    """
    draw = ImageDraw.Draw(image)
    is_seen = np.isfinite(points).all(axis=-1) & (confidence > 0)
    # Far outside there is nothing to see, and drawing takes time with the distance.
    points = np.clip(np.nan_to_num(points), -max(image.size), 2 * max(image.size))
    for parent, child in skeleton.bones:
        if not (is_seen[parent] and is_seen[child]):
            continue
        name = skeleton.joints[child]
        share = _FINGER_WIDTH if name.endswith(("_1", "_2", "_3")) else _BODY_WIDTH
        width = max(1, round(share * max(image.size)))
        certainty = min(confidence[parent], confidence[child])
        side = name.split("_")[0]
        colour = _GREY + certainty * (np.array(_COLOURS.get(side, _COLOURS[""])) - _GREY)
        ends = [tuple(points[parent].tolist()), tuple(points[child].tolist())]
        draw.line(ends, fill=_EDGE, width=width + 2)
        draw.line(ends, fill=tuple(colour.astype(int).tolist()), width=width)


class _Sound:
    """The sound of a video on its way into another file; nothing where it has none."""

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
        """Writes what is heard before `time`, in seconds; at infinity the end, too."""
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
    """The sound in blocks that AAC takes: mono or stereo."""
    try:
        with av.open(str(video)) as source:
            if not source.streams.audio:
                return
            stream = source.streams.audio[0]
            rate = next((known for known in _SOUND_RATES if known <= stream.rate), _SOUND_RATES[-1])
            layout = "mono" if stream.channels == 1 else "stereo"
            to_aac = av.AudioResampler(format="fltp", layout=layout, rate=rate)
            for frame in itertools.chain(source.decode(stream), [None]):
                if frame is not None:
                    frame.pts = None
                yield from to_aac.resample(frame)
    except (FFmpegError, ValueError) as error:
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        raise UserError(f"{video} has sound that cannot be read ({reason}); expected a whole file") from error
