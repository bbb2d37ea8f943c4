"""Detection of the shots of a video."""

import itertools
import pathlib
from fractions import Fraction

from ha2g_jax.errors import UserError
from ha2g_jax.importers.video.decoding import decode, no_images, open_video

_DEFAULT_RATE = 25
_WIDTH = 256  # pixels, for speed; about the size to which PySceneDetect reduces images, for which its thresholds hold
_FLASH_SECONDS = 0.5  # cuts that are closer in time count as one


def check_installed() -> None:
    """Check that PySceneDetect is installed.

    Raises:
        UserError: it is not, or cannot be imported.
    """
    try:
        import scenedetect  # noqa: F401
    except ImportError as error:
        raise UserError(
            f"videos need PySceneDetect, which cannot be imported ({error}); run pip install 'ha2g-jax[video]'"
        ) from error


def find_shots(
    video: pathlib.Path, *, threshold: float = 27.0, min_seconds: float = 0.0
) -> tuple[tuple[int, int], ...]:
    """Find the shots of a video by PySceneDetect's content detector.

    Images are counted as they are decoded and passed to the detector by number, so that shots are in numbers of images
    even if the frame rate varies; PySceneDetect alone would count time.

    Args:
        video: path of a video.
        threshold: mean change of hue, saturation and brightness (each of 255) between two images that makes a cut.
        min_seconds: minimum length of a shot in seconds.

    Returns:
        [first image, end image) of each shot, in order of time; the whole video if it has no cut.

    Raises:
        UserError: the file has no readable images, or PySceneDetect is not installed.
    """
    check_installed()
    from scenedetect import ContentDetector, FrameTimecode

    video = pathlib.Path(video)
    detector = ContentDetector(threshold=threshold, min_scene_len=_FLASH_SECONDS)
    borders, num_frames = [0], 0
    with open_video(video) as container:
        stream = container.streams.video[0]
        rate = Fraction(stream.average_rate or stream.guessed_rate or _DEFAULT_RATE)
        for frame in decode(video, container):
            width = min(_WIDTH, frame.width)
            height = max(1, round(frame.height * width / frame.width))
            image = frame.to_ndarray(format="bgr24", width=width, height=height)
            cuts = detector.process_frame(FrameTimecode(num_frames, rate), image)
            borders += [cut.frame_num for cut in cuts]
            num_frames += 1
    if not num_frames:
        raise no_images(video)
    borders = sorted({*borders, num_frames})
    return tuple((start, end) for start, end in itertools.pairwise(borders) if end - start >= min_seconds * rate)
