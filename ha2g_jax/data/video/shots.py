"""Where a video cuts from one camera to another."""

import itertools
import pathlib
from fractions import Fraction

from ha2g_jax.data.video import frames
from ha2g_jax.errors import UserError

_DEFAULT_RATE = 25
_WIDTH = 256  # pixels, for speed; PySceneDetect shrinks its pictures about as much, and its thresholds mean such
_FLASH_SECONDS = 0.5  # cuts that follow one another faster are one


def find_shots(
    video: pathlib.Path, *, threshold: float = 27.0, min_seconds: float = 0.0
) -> tuple[tuple[int, int], ...]:
    """The shots of a video, by PySceneDetect's content detector.

    The pictures are counted here as they are decoded, and handed to the detector by number, so that frame k is the k-th
    picture even where the frame rate varies; PySceneDetect alone would count time.

    Args:
        video: a file with pictures.
        threshold: mean change of hue, saturation and brightness (each of 255) from one picture to the next that makes
            a cut.
        min_seconds: shorter shots are left out.

    Returns:
        [first frame, end frame) of each shot, in order of time; the whole video if it has no cut.

    Raises:
        UserError: the file has no pictures that can be read, or PySceneDetect is not installed.
    """
    try:
        from scenedetect import ContentDetector, FrameTimecode
    except ImportError as error:
        raise UserError(
            f"videos need PySceneDetect, which cannot be imported ({error}); pip install 'ha2g-jax[video]'"
        ) from error
    video = pathlib.Path(video)
    detector = ContentDetector(threshold=threshold, min_scene_len=_FLASH_SECONDS)
    borders, num_frames = [0], 0
    with frames.open_video(video) as container:
        stream = container.streams.video[0]
        rate = Fraction(stream.average_rate or stream.guessed_rate or _DEFAULT_RATE)
        for frame in frames.decode(video, container):
            width = min(_WIDTH, frame.width)
            height = max(1, round(frame.height * width / frame.width))
            picture = frame.to_ndarray(format="bgr24", width=width, height=height)
            cuts = detector.process_frame(FrameTimecode(num_frames, rate), picture)
            borders += [cut.frame_num for cut in cuts]
            num_frames += 1
    if not num_frames:
        raise UserError(f"{video} has no pictures; expected a video of a speaker")
    borders = sorted({*borders, num_frames})
    return tuple((start, end) for start, end in itertools.pairwise(borders) if end - start >= min_seconds * rate)
