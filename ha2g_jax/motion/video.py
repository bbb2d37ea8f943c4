"""A video of the figure that performs a motion, or of several side by side, with the sound."""

import fractions
import pathlib
from collections.abc import Iterator, Mapping

import av
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from tqdm import tqdm

from ha2g_jax.figure import DEFAULT_LOOK, Look, draw_figure
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.skeleton import directions_to_positions
from ha2g_jax.whole_file import whole_file

VIDEO_FPS = 30
# One thread: the bytes of H.264 depend on the number, and with more of them about one video in a hundred differs.
_ENCODER = {"preset": "veryfast", "crf": "21", "threads": "1"}
_INK = (70, 74, 82)


def write_video(
    path: str | pathlib.Path,
    motion: Motion | Mapping[str, Motion],
    audio: np.ndarray,
    sample_rate: int = 16000,
    *,
    look: Look = DEFAULT_LOOK,
    size: int = 720,
    has_progress: bool = True,
) -> None:
    """Writes an mp4 (H.264 and AAC, 30 frames a second) that lasts as long as the sound.

    The poses between the motion's frames are interpolated on the sphere. The same input gives the same bytes on one
    machine. The file is whole or not there.

    Args:
        path: the `.mp4` to write.
        motion: what the figure does; several motions by name are drawn side by side, each with its name.
        audio: (samples,) float32 mono sound.
        sample_rate: samples per second.
        look: how the figure is dressed.
        size: width and height of a figure's picture in pixels, even.
        has_progress: whether to show a progress bar; it needs a terminal.

    Raises:
        UserError: the place cannot be written.
    """
    frames = num_frames(len(audio) / sample_rate, VIDEO_FPS)
    motions = motion if isinstance(motion, Mapping) else {"": motion}
    pictures = zip(*(_pictures(name, motion, frames, look, size) for name, motion in motions.items()), strict=True)
    options = {"movflags": "faststart", "fflags": "+bitexact"}
    with whole_file(path) as temporary, av.open(str(temporary), "w", format="mp4", options=options) as container:
        video = container.add_stream("libx264", rate=VIDEO_FPS, options=_ENCODER)
        video.width, video.height = size * len(motions), size
        video.pix_fmt = "yuv420p"
        sound = container.add_stream("aac", rate=sample_rate, layout="mono")
        blocks = _sound_frames(audio, sample_rate)
        disable = None if has_progress else True
        for index, panels in enumerate(tqdm(pictures, desc="video", total=frames, unit="frame", disable=disable)):
            image = np.concatenate(panels, axis=1)
            container.mux(video.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
            if index % VIDEO_FPS == 0:  # a second of sound follows the first picture of the second
                container.mux([packet for block in next(blocks, ()) for packet in sound.encode(block)])
        for seconds in blocks:
            container.mux([packet for block in seconds for packet in sound.encode(block)])
        container.mux(sound.encode(None))
        container.mux(video.encode(None))


def _pictures(name: str, motion: Motion, frames: int, look: Look, size: int) -> Iterator[np.ndarray]:
    """The figure in each frame of the video, (size, size, 3) uint8, with a name unless it is empty."""
    skeleton = motion.skeleton
    poses = directions_to_positions(skeleton, resample(motion.directions, motion.fps, VIDEO_FPS, frames))
    for pose in poses:
        picture = draw_figure(pose, skeleton, look, size, size)
        yield _label(picture, name) if name else picture


def _label(picture: np.ndarray, name: str) -> np.ndarray:
    """The picture with a name in its upper left corner, where the figure seldom is."""
    height = len(picture)
    image = Image.fromarray(picture)
    font = ImageFont.load_default(height / 18)
    ImageDraw.Draw(image).text((height / 24, height / 24), name, fill=_INK, font=font, anchor="lt")
    return np.asarray(image)


def _sound_frames(audio: np.ndarray, sample_rate: int) -> Iterator[list[av.AudioFrame]]:
    """Seconds of sound as frames for the encoder, which takes 1024 samples at a time."""
    samples = np.clip(np.asarray(audio, np.float32), -1, 1)
    for second in range(0, len(samples), sample_rate):
        frame = av.AudioFrame.from_ndarray(samples[None, second : second + sample_rate], format="fltp", layout="mono")
        frame.sample_rate, frame.pts = sample_rate, second
        frame.time_base = fractions.Fraction(1, sample_rate)
        yield [frame]
