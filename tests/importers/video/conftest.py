"""Tiny videos, made on the spot."""

import pathlib
import sys
from collections.abc import Callable, Sequence
from fractions import Fraction

import av
import numpy as np
import pytest

WIDTH, HEIGHT = 64, 48
SOUND_RATE = 16000


@pytest.fixture(scope="session")
def make_video() -> Callable[..., pathlib.Path]:
    """Writes a video of images of the colours given, or with a tone and reddish images with 10 + k % 150 of green."""

    def make(
        path: pathlib.Path,
        *,
        seconds: float = 6.0,
        fps: int = 10,
        with_sound: bool = True,
        times: np.ndarray | None = None,
        colours: Sequence[tuple[int, int, int]] | None = None,
        sound_start: float = 0.0,
        **options: str,
    ) -> pathlib.Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        count, has_sound = (round(seconds * fps), with_sound) if colours is None else (len(colours), False)
        times = np.arange(count) / fps if times is None else times
        with av.open(str(path), "w", options=options) as container:
            images = container.add_stream("mpeg4", rate=fps, options={"qscale": "1"})
            images.width, images.height, images.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            images.time_base = images.codec_context.time_base = Fraction(1, 1000)
            sound = container.add_stream("aac", rate=SOUND_RATE, layout="mono") if has_sound else None
            for number, time in enumerate(times):
                colour = np.array([60, 0, 20]) + 10 + number % 150 if colours is None else colours[number]
                image = np.full((HEIGHT, WIDTH, 3), colour, np.uint8)
                frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format="yuv420p")
                frame.pts, frame.time_base = round(time * 1000), Fraction(1, 1000)
                container.mux(images.encode(frame))
            container.mux(images.encode())
            if sound:
                samples = np.sin(0.1 * np.arange(round((seconds - sound_start) * SOUND_RATE)))
                part = av.AudioFrame.from_ndarray(0.3 * samples[None].astype(np.float32), format="fltp", layout="mono")
                part.sample_rate, part.pts = SOUND_RATE, round(sound_start * SOUND_RATE)
                container.mux(sound.encode(part))
                container.mux(sound.encode())
        return path

    return make


# A stand-in for an estimator of poses: one pose a image, hands that wave. What else it does, its last argument says.
ESTIMATOR = """
import os, pathlib, signal, sys, time
import av, numpy as np
from ha2g_jax.skeleton import load_skeleton

video, out, log, kind = sys.argv[1:]
name = pathlib.Path(video).stem
with open(log, "a") as file:
    file.write(name + "\\n")
notes = pathlib.Path(log).parent
with av.open(video) as container:
    count = sum(1 for _ in container.decode(video=0))
if kind == "kill" and name.endswith("2") and not (notes / "killed").exists():
    (notes / "killed").touch()
    victim = os.getppid()
    for _ in range(int(os.environ.get("ABOVE", 0))):
        victim = int(pathlib.Path(f"/proc/{victim}/stat").read_text().rpartition(")")[2].split()[1])
    os.kill(victim, signal.SIGKILL)
    time.sleep(60)
if kind == "wait" and name.endswith("2") and not (notes / "waiting").exists():
    (notes / "waiting").touch()
    time.sleep(600)
skeleton = load_skeleton("ted_expressive")
positions = np.tile(skeleton.mean_pose, (count, 1, 1)).astype(np.float32)
if kind != "still":
    positions[:, 6:38] += 0.15 * np.sin(np.arange(count) * 0.7)[:, None, None]
confidence = np.ones((count, 43), np.float32)
confidence[: count // 4, 20] = 0
if kind == "unseen":
    confidence[: count // 2 + 1, 20] = 0
positions[confidence == 0] = np.nan
points = np.tile(np.array([32.0, 24.0], np.float32), (count, 43, 1)) + 40 * positions[..., :2]
short = 1 if kind == "short" else 0
np.savez(out, positions=positions[short:], confidence=confidence[short:], image_points=points[short:], fps=10.0)
"""


@pytest.fixture(scope="session")
def pose_command(tmp_path_factory: pytest.TempPathFactory) -> Callable[[pathlib.Path, str], str]:
    """The command of a stand-in estimator that notes each call in a file, and the kind of what it does."""
    script = tmp_path_factory.mktemp("estimator") / "estimate.py"
    script.write_text(ESTIMATOR)

    def command(log: pathlib.Path, kind: str = "wave") -> str:
        return f"{sys.executable} {script} {{video}} {{out}} {log} {kind}"

    return command


def write_words(path: pathlib.Path, seconds: float = 6.0) -> pathlib.Path:
    """A transcript of a word each half second."""
    times = np.arange(0.1, seconds - 0.4, 0.5)
    rows = [f"{time:.2f}\t{time + 0.3:.2f}\tword{number}" for number, time in enumerate(times)]
    path.write_text("start\tend\tword\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="session")
def make_recording(make_video) -> Callable[..., pathlib.Path]:
    """A video with its transcript beside it."""

    def make(path: pathlib.Path, **options) -> pathlib.Path:
        make_video(path, **options)
        write_words(path.with_suffix(".tsv"), options.get("seconds", 6.0))
        return path

    return make
