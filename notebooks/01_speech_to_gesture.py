# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Speech to gesture
#
# This notebook generates the motion of an upper body with fingers from a speech file. It loads the demo model of
# the package, animates a sentence, shows the motion as images, curves and video, and shows the effect of the
# speaking style.
#
# The demo model was trained on the *Talk corpus*, which is synthetic (see `docs/talk.md`). It is a testbed, not a
# model of people.

# %%
import pathlib
import tempfile

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Video

import ha2g_jax
from ha2g_jax import figure
from ha2g_jax.features import audio
from ha2g_jax.motion import video
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.synthesis import Style

speech = pathlib.Path("../examples/hello.wav")
model = ha2g_jax.load("demo")
motion = model.generate(speech, seed=0)
motion.positions.shape, motion.fps

# %% [markdown]
# `motion.directions` are unit vectors along the 42 bones, and `motion.positions` are the positions of the 43
# joints in metres, with y pointing down. There are exactly `round(duration x fps)` frames.

# %%
skeleton = load_skeleton("ted_expressive")
frames = np.linspace(0, len(motion.positions) - 1, 6).astype(int)
view = figure.fit([(motion.positions, skeleton)])
_, axes = plt.subplots(1, len(frames), figsize=(15, 3))
for axis, frame in zip(axes, frames, strict=True):
    axis.imshow(figure.draw_figure(motion.positions[frame], skeleton, figure.DEFAULT_LOOK, 360, 360, view))
    axis.set_title(f"{frame / motion.fps:.1f} s")
    axis.axis("off")
plt.show()

# %% [markdown]
# ## Does the motion follow the sound?
#
# The plot shows the speed of the wrists below the loudness of the speech: strokes occur at stressed syllables.

# %%
samples = audio.read_audio(speech)
loudness = audio.log_mel(samples).mean(axis=0)
wrists = motion.positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]]
speed = np.linalg.norm(np.diff(wrists, axis=0), axis=-1) * motion.fps

_, (top, bottom) = plt.subplots(2, sharex=True, figsize=(12, 4))
top.plot(np.arange(len(loudness)) * audio.HOP_LENGTH / audio.SAMPLE_RATE, loudness, color="gray")
top.set_ylabel("loudness (dB)")
bottom.plot(np.arange(len(speed)) / motion.fps, speed, label=["left", "right"])
bottom.set_ylabel("wrist speed (m/s)")
bottom.set_xlabel("time (s)")
bottom.legend()
plt.show()

# %% [markdown]
# ## Style
#
# The same speech in the styles of several speakers. A style can also be that of a person in images
# (`Style(images=[...])`), or be drawn from the prior (`Style(seed=7)`).

# %%
speakers = list(model.assets.speakers)[:4]
_, axes = plt.subplots(1, len(speakers), figsize=(12, 3))
for axis, speaker in zip(axes, speakers, strict=True):
    positions = model.generate(speech, style=Style(speaker=speaker), seed=0).positions
    wrists = positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]]
    axis.plot(wrists[:, :, 0], -wrists[:, :, 1])
    axis.set_title(speaker)
    axis.set_aspect("equal")
plt.show()

# %% [markdown]
# ## A video with sound
#
# `ha2g generate` writes the same video beside the `.npz`.

# %%
path = pathlib.Path(tempfile.mkdtemp()) / "hello.mp4"
video.write_video(path, motion, samples)
Video(path, embed=True, width=480)
