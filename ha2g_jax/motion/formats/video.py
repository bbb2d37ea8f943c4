"""Videos of a figure with a motion, or of several figures side by side, with the sound."""

import concurrent.futures
import fractions
import functools
import itertools
import os
import pathlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import cast

import av
import numpy as np
from av.audio.stream import AudioStream
from av.codec.context import Flags
from av.video.codeccontext import VideoCodecContext
from av.video.reformatter import ColorRange

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import check_mono
from ha2g_jax.figure import DEFAULT_LOOK, SHIRTS, View, align, fit, view_of
from ha2g_jax.figure.stage import Stage, draw, paint, set_stage
from ha2g_jax.files.writing import whole_file
from ha2g_jax.limits import MAX_FPS
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.progress import progress_bar
from ha2g_jax.skeleton import Skeleton, directions_to_positions

VIDEO_FPS = 30
MIN_SIDE, MAX_SIDE = 32, 4096  # pixels; players of H.264 need not support more than 4096

_PIECE = 60  # frames that are drawn and encoded together, whatever the number of workers
# One thread for each encoder: the bytes of H.264 depend on the number of threads. On plain shapes slower presets take
# twice the time for a file that is a third smaller and looks the same.
_ENCODER = {
    "preset": "ultrafast",
    "crf": "25",
    "threads": "1",
    "x264-params": "bframes=0:rc-lookahead=0:mbtree=0:weightp=0:scenecut=0:subme=0:me=dia",
}
_BT709 = 1  # code of this standard in H.264


def write_video(
    path: str | pathlib.Path,
    motion: Motion | Mapping[str, Motion],
    audio: np.ndarray | None,
    sample_rate: int = 16000,
    *,
    size: int | tuple[int, int] = 720,
    camera: str = "body",
    fps: float | None = None,
    view: View | None = None,
    workers: int | None = None,
    has_progress: bool = True,
) -> None:
    """Write an `.mp4` (H.264 and AAC) that lasts as long as the sound.

    The poses between the frames of a motion are interpolated on the sphere. A fixed camera shows all figures at one
    size, the largest at which hands and head stay in the picture. The same input gives the same bytes on one machine,
    whatever the number of workers. The file is written atomically.

    Args:
        motion: one motion, or several by name, whose figures are drawn side by side with their names.
        audio: (samples,) mono sound, floats or integers, see `features.audio.check_mono`; with None the video is silent
            and lasts as long as the longest motion.
        size: width and height of the picture in pixels, both even, or one number for the side of a square for each
            figure.
        camera: one of `figure.CAMERAS`: "body" to the hips and the lowest hands, "close" for the upper body and hands.
        fps: frames per second, 1 to `limits.MAX_FPS`; 30 by default.
        view: view of all figures, such as that of `fit_view` for several videos; by default it is fitted to this one.
        workers: number of threads that draw and encode; by default one for each core.

    Raises:
        UserError: a motion is not valid (see `Motion.check`), the sound or its rate cannot be used, the size or rate is
            out of range, there is no such camera, or the file cannot be written.
    """
    motions = motion if isinstance(motion, Mapping) else {"": motion}
    for each in motions.values():
        each.check()
    if audio is not None:
        audio, sample_rate = check_mono(audio, sample_rate)
    width, height = check_size(size if isinstance(size, tuple) else (size * len(motions), size))
    longest = max(each.num_frames / each.fps for each in motions.values())
    rate = _to_rate(fps)
    frames = num_frames(longest if audio is None else len(audio) / sample_rate, float(rate))
    poses = [_poses(each, frames, float(rate)) for each in motions.values()]
    views = align([_fit_poses([pose], view_of(camera)) if view is None else view for pose in poses])
    stage = set_stage(tuple(motions), DEFAULT_LOOK.background, width, height, views)
    encode = functools.partial(_encode_piece, stage, poses, views, rate)
    options = {"movflags": "faststart", "fflags": "+bitexact"}
    with (
        whole_file(path) as temporary,
        concurrent.futures.ThreadPoolExecutor(workers or os.cpu_count()) as executor,
        av.open(f"file:{temporary}", "w", format="mp4", options=options) as container,
        progress_bar("drawing the video", frames, "frame", is_shown=has_progress) as bar,
    ):
        video = container.add_stream("libx264", rate=rate, options=_ENCODER)
        _set_up(video.codec_context, width, height)
        sound: Iterator[list[av.Packet]] = iter(())
        if audio is not None:
            sound = encode_sound(container.add_stream("aac", rate=sample_rate, layout="mono"), audio, sample_rate)
        try:
            for packets in executor.map(encode, range(0, frames, _PIECE)):
                for packet in packets:
                    packet.stream = video
                container.mux(packets)
                seconds = max(1, round(_PIECE / rate))
                container.mux([packet for second in itertools.islice(sound, seconds) for packet in second])
                bar.update(len(packets))
        finally:
            executor.shutdown(cancel_futures=True)
        container.mux([packet for second in sound for packet in second])


def fit_view(motions: Iterable[Motion], seconds: float) -> View:
    """Fit one camera to all poses of several motions in some seconds, so that `write_video` shows them at one size."""
    frames = num_frames(seconds, VIDEO_FPS)
    return _fit_poses((_poses(each, frames, VIDEO_FPS) for each in motions), view_of("body"))


def _to_rate(fps: float | None) -> fractions.Fraction:
    if fps is not None and not 1 <= fps <= MAX_FPS:
        raise UserError(f"a video of {fps:g} frames per second; give 1 to {MAX_FPS}")
    return fractions.Fraction(VIDEO_FPS if fps is None else fps).limit_denominator(1001)  # 30000/1001 of television


def _poses(motion: Motion, frames: int, fps: float) -> tuple[np.ndarray, Skeleton]:
    return resample(motion.directions, motion.fps, fps, frames), motion.skeleton


def _fit_poses(poses: Iterable[tuple[np.ndarray, Skeleton]], least: View) -> View:
    return fit(((directions_to_positions(skeleton, directions), skeleton) for directions, skeleton in poses), least)


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return the width and height of a video in pixels; sides that are odd, too small or too large are a UserError."""
    if any(side % 2 or not MIN_SIDE <= side <= MAX_SIDE for side in size):
        raise UserError(
            f"the size of the video is {size[0]}x{size[1]} pixels; give even sides of {MIN_SIDE} to {MAX_SIDE}"
        )
    return size


def _encode_piece(
    stage: Stage,
    poses: Sequence[tuple[np.ndarray, Skeleton]],
    views: Sequence[View],
    rate: fractions.Fraction,
    start: int,
) -> list[av.Packet]:
    """Encode the pictures of one piece from frame `start`, whose first picture does not depend on the one before."""
    drawings = []
    for index, (directions, skeleton) in enumerate(poses):
        positions = directions_to_positions(skeleton, directions[start : start + _PIECE])
        look = DEFAULT_LOOK._replace(shirt=SHIRTS[index % len(SHIRTS)])
        drawings.append(draw(stage, index, positions, skeleton, look, views[index]))
    height, width = stage.clean[0].shape
    encoder = cast(VideoCodecContext, av.CodecContext.create("libx264", "w"))
    encoder.options, encoder.time_base, encoder.framerate = _ENCODER, 1 / rate, rate
    encoder.flags |= Flags.global_header
    _set_up(encoder, width, height)
    packets = []
    for index in range(len(drawings[0].points)):
        picture = av.VideoFrame(width, height, "yuv420p")
        picture.pts = start + index
        paint(stage, drawings, index, _planes(picture))
        packets += encoder.encode(picture)
    return packets + encoder.encode(None)


def _set_up(encoder: VideoCodecContext, width: int, height: int) -> None:
    encoder.width, encoder.height, encoder.pix_fmt = width, height, "yuv420p"
    encoder.color_range = ColorRange.MPEG
    encoder.colorspace, encoder.color_primaries, encoder.color_trc = _BT709, _BT709, _BT709


def _planes(picture: av.VideoFrame) -> list[np.ndarray]:
    return [
        np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)[: plane.height, : plane.width]
        for plane in picture.planes
    ]


def encode_sound(stream: AudioStream, audio: np.ndarray, sample_rate: int) -> Iterator[list[av.Packet]]:
    """Yield the packets of mono sound (samples,), second by second."""
    samples = np.clip(np.asarray(audio, np.float32), -1, 1)
    for second in range(0, len(samples), sample_rate):
        block = samples[None, second : second + sample_rate]
        frame = av.AudioFrame.from_ndarray(block, format="fltp", layout="mono")
        frame.sample_rate, frame.pts = sample_rate, second
        frame.time_base = fractions.Fraction(1, sample_rate)
        yield stream.encode(frame)
    yield stream.encode(None)
