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
# This notebook generates the motion of an upper body with fingers from a speech file. It loads the demo model of the
# package, animates a sentence, shows the motion as images, curves and video, and shows the effect of the speaking
# style.
#
# The demo model was trained on the *Talk corpus*, which is synthetic (see `docs/talk.md`). It is a testbed, not a
# model of people.

# %%
from ha2g_jax.files.cache import keep_programs

keep_programs()  # compiled programs are kept for the next run, as the command ha2g does

import pathlib
import tempfile

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Video

import ha2g_jax
from ha2g_jax import figure
from ha2g_jax.features import audio, spectrum
from ha2g_jax.motion import formats
from ha2g_jax.motion.formats import video
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.synthesis import Style

speech = pathlib.Path("../examples/hello.wav")
model = ha2g_jax.load("demo")
motion = model.generate(speech, seed=0)
motion.positions.shape, motion.fps

# %% [markdown]
# `motion.directions` are unit vectors along the 42 bones, and `motion.positions` are the positions of the 43 joints
# in metres, with y pointing down. There are exactly `round(duration x fps)` frames.

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
loudness = spectrum.log_mel(samples).mean(axis=0)
wrists = motion.positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]]
speed = np.linalg.norm(np.diff(wrists, axis=0), axis=-1) * motion.fps

_, (top, bottom) = plt.subplots(2, sharex=True, figsize=(12, 4))
top.plot(np.arange(len(loudness)) * spectrum.HOP_LENGTH / audio.SAMPLE_RATE, loudness, color="gray")
top.set_ylabel("loudness (dB)")
bottom.plot(np.arange(len(speed)) / motion.fps, speed, label=["left", "right"])
bottom.set_ylabel("wrist speed (m/s)")
bottom.set_xlabel("time (s)")
bottom.legend()
plt.show()

# %% [markdown]
# ## Styles and takes
#
# The same speech in the styles of four speakers, two takes of each: the lines are the paths of the wrists, seen from
# the front. Another speaker gestures in another space; another seed is another take of the same speaker, whose style
# is varied a little, as people do not speak twice in the same manner (`Style(speaker=..., variation=0)` is the exact
# style). A style can also be that of a person in images (`Style(images=[...])`), a mixture of speakers, or random
# (`Style(seed=7)`, and by default).

# %%
speakers = list(model.assets.speakers)[:4]
_, axes = plt.subplots(2, len(speakers), figsize=(12, 5), sharex=True, sharey=True)
for take, row in enumerate(axes):
    for axis, speaker in zip(row, speakers, strict=True):
        positions = model.generate(speech, style=Style(speaker=speaker), seed=take).positions
        wrists = positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]]
        axis.plot(wrists[:, :, 0], -wrists[:, :, 1], linewidth=0.9)
        axis.set_title(f"{speaker}, take {take}")
        axis.set_aspect("equal")
plt.show()

# %% [markdown]
# ## To other programs
#
# The suffix is the format: glTF for any viewer, BVH for animation programs, VRMA for VRM avatars, JSON and CSV for
# your own. `rig` names the bones of the file. The solver finds joint rotations from the direction vectors; read back,
# a BVH with the rig `ha2g` has the same directions; on the bones of Mixamo those of face and palm differ a little
# (`docs/export.md`).

# %%
folder = pathlib.Path(tempfile.mkdtemp())
for name, rig in {"hello.glb": "ha2g", "hello.bvh": "mixamo", "hello.vrma": "vrm", "hello.json": "ha2g"}.items():
    formats.export(motion, folder / name, rig=rig)
    print(f"{name:12} {rig:8} {(folder / name).stat().st_size / 1e3:6.0f} kB")

read = read_motion(folder / "hello.bvh", skeleton="ted_expressive")
wrist = skeleton.joint("right_wrist")
_, axis = plt.subplots(figsize=(12, 2.5))
axis.plot(
    np.arange(motion.num_frames) / motion.fps, -motion.positions[:, wrist, 1], linewidth=4, alpha=0.4, label="motion"
)
axis.plot(np.arange(read.num_frames) / read.fps, -read.positions[:, wrist, 1], label="read back from hello.bvh")
axis.set_xlabel("time (s)")
axis.set_ylabel("right wrist (m)")
axis.legend()
plt.show()

# %% [markdown]
# ## A video with sound
#
# `ha2g generate` writes such a video beside the `.npz`; this one is small and shows the first three seconds.

# %%
start = model.generate(samples[: 3 * audio.SAMPLE_RATE], seed=0)
video.write_video(folder / "hello.mp4", start, samples[: 3 * audio.SAMPLE_RATE], size=200)
Video(folder / "hello.mp4", embed=True, width=360)
