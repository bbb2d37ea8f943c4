"""Draw docs/images/demo.gif, the moving picture of the README: the demo model's motion for 6 s of examples/hello.wav.

ha2g generate examples/hello.wav --fps 10 --out out/demo.npz
python docs/images/demo.py out/demo.npz examples/hello.wav docs/images/demo.gif
"""

import sys

import numpy as np
from PIL import Image, ImageDraw

from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.figure import DEFAULT_LOOK, View, draw_figure, fit
from ha2g_jax.motion.motion import Motion

START, SECONDS = 5.6, 6.0
WIDTH, FIGURE, WAVE = 400, 340, 60  # pixels: width of all, heights of the figure and of the waveform
PAPER, PAST, FUTURE = (250, 250, 252), (62, 110, 160), (190, 198, 208)
COLOURS = 64


def main(motion_path: str, speech: str, out: str) -> None:
    motion, audio = Motion.load(motion_path), read_audio(speech)
    audio = audio[int(START * SAMPLE_RATE) :][: int(SECONDS * SAMPLE_RATE)]
    levels = np.abs(audio[: len(audio) // WIDTH * WIDTH]).reshape(WIDTH, -1).max(axis=1)
    heights = np.maximum(1, 0.45 * WAVE * levels / levels.max())
    first = round(START * motion.fps)
    frames = range(first, first + round(SECONDS * motion.fps))
    view = fit([(motion.positions[frames], motion.skeleton)])
    pictures = [_picture(motion, frame, view, heights, (frame - first) / len(frames)) for frame in frames]
    palette = pictures[len(pictures) // 2].quantize(COLOURS, dither=Image.Dither.NONE)
    pictures = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = round(1000 / motion.fps)
    pictures[0].save(out, "GIF", save_all=True, append_images=pictures[1:], duration=duration, loop=0, optimize=True)


def _picture(motion: Motion, frame: int, view: View, heights: np.ndarray, done: float) -> Image.Image:
    """Return the figure above the waveform, of which the part that was heard is dark."""
    picture = Image.new("RGB", (WIDTH, FIGURE + WAVE), PAPER)
    figure = draw_figure(motion.positions[frame], motion.skeleton, DEFAULT_LOOK, WIDTH, FIGURE, view)
    picture.paste(Image.fromarray(figure))
    draw, middle = ImageDraw.Draw(picture), FIGURE + WAVE / 2
    for x in range(0, WIDTH, 3):
        height = heights[x : x + 3].max()
        draw.line((x, middle - height, x, middle + height), PAST if x < done * WIDTH else FUTURE, 2)
    return picture


if __name__ == "__main__":
    main(*sys.argv[1:])
