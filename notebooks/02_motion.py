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
# # View motion, and stream it
#
# This notebook shows generated motion in the viewer, several motions side by side, and writes a page that can be sent
# to others. Then it generates the same motion live, while the speech arrives. Drag to rotate the figure; space plays,
# `?` lists the keys (`docs/viewer.md`).

# %%
from ha2g_jax.files.cache import keep_programs

keep_programs()  # compiled programs are kept for the next run, as the command ha2g does

import pathlib
import tempfile
import time

import matplotlib.pyplot as plt
import numpy as np

import ha2g_jax
from ha2g_jax import viewer
from ha2g_jax.features import audio
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import mirror_directions
from ha2g_jax.synthesis import Style

speech = pathlib.Path("../examples/hello.wav")
samples = audio.read_audio(speech)
model = ha2g_jax.load("demo")
motion = model.generate(speech, seed=0)

# %% [markdown]
# ## Side by side
#
# `viewer.view(motion, samples)` shows one motion. Here are three: the same speech in two styles, and the first motion
# mirrored. Press `o` to overlay the motions and `b` to show the bones; the names of the joints appear at the pointer.

# %%
mirrored = Motion.from_directions(motion.skeleton, mirror_directions(motion.skeleton, motion.directions), motion.fps)
motions = {
    "style 0": motion,
    "style 7": model.generate(speech, seed=0, style=Style(seed=7)),
    "style 0 mirrored": mirrored,
}
viewer.view(motions, samples, height=520)

# %% [markdown]
# ## A page to share
#
# The page is one file that works offline. `ha2g export MOTION ... --audio WAV -o view.html` writes the same page.

# %%
page = viewer.view(motions, samples).save(pathlib.Path(tempfile.mkdtemp()) / "styles.html")
print(f"{page.stat().st_size / 1e6:.1f} MB")

# %% [markdown]
# ## Live
#
# A stream follows speech that arrives in pieces of any length, here of 20 ms, as a microphone or a speech synthesiser
# gives them. `feed` returns the frames that became final. Frame k shows the time k / fps and is made when
# `look_ahead` more frames of the speech have been heard, so that the latency is at most (look_ahead + hop) / fps
# (`docs/live.md`; the command is `ha2g live`).

# %%
piece = audio.SAMPLE_RATE // 50
style = Style(speaker="speaker-00", variation=0)
streams = {}
for look_ahead in (3, 8):
    stream = model.stream(look_ahead=look_ahead, style=style)
    frames, heard, seconds = [], [], []
    for start in range(0, len(samples), piece):
        begin = time.process_time()
        new = stream.feed(samples[start : start + piece])
        if len(new):
            seconds.append(time.process_time() - begin)
        frames.extend(new)
        heard.extend([(start + piece) / audio.SAMPLE_RATE] * len(new))
    final = len(heard)
    frames.extend(stream.flush())
    streams[look_ahead] = Motion.from_directions(stream.skeleton, np.array(frames), stream.fps), np.array(heard)
    late, computed = 1000 * (np.array(heard) - np.arange(final) / stream.fps), 1000 * np.median(seconds)
    print(
        f"look-ahead {look_ahead}: {len(frames)} frames of {1000 / stream.fps:.0f} ms, "
        f"a run of two takes {computed:.0f} ms of a core"
    )
    print(
        f"  latency stated {1000 * stream.latency:.0f} ms, measured {late.mean():.0f} ms, at most {late.max():.0f} ms"
    )

# %% [markdown]
# On the left, the frames as they arrive: each step is a run of two frames, and its distance from the dotted line,
# where a frame would be shown at its own moment, is the latency. On the right, what is gained by it: the height of a
# wrist in the streams beside that in the file, which has heard all of the speech. A beat begins before its syllable,
# so a stream that hears only 3 frames ahead misses some of them, such as those near 7 s; with 8 frames the strokes are
# as large as those of the file, and mostly at the same moments. `docs/live.md` has the scores.

# %%
file = model.generate(speech, style=style)
wrist = file.skeleton.joint("right_wrist")
_, (left, right) = plt.subplots(1, 2, figsize=(14, 4), width_ratios=(1, 2))
for look_ahead, (streamed, heard) in streams.items():
    left.step(heard, np.arange(len(heard)) / streamed.fps, where="post", label=f"look-ahead {look_ahead}")
    right.plot(
        np.arange(streamed.num_frames) / streamed.fps,
        -streamed.positions[:, wrist, 1],
        label=f"look-ahead {look_ahead}",
    )
left.plot((2, 3.5), (2, 3.5), ":", color="gray")
left.set_xlim(2, 3.5)
left.set_ylim(1, 3.5)
left.set_xlabel("speech heard (s)")
left.set_ylabel("time that the newest frame shows (s)")
left.legend()
right.plot(
    np.arange(file.num_frames) / file.fps, -file.positions[:, wrist, 1], color="black", linewidth=0.8, label="file"
)
right.set_xlabel("time (s)")
right.set_ylabel("height of the right wrist (m)")
right.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=3)
plt.show()
