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
# # Looking at motion
#
# Generated motion in the viewer, several side by side, and one of them as a page to send to somebody. Turn the figure
# by dragging; space plays, `?` lists the keys (`docs/viewer.md`).

# %%
import pathlib
import tempfile

import ha2g_jax
from ha2g_jax import viewer
from ha2g_jax.features import audio
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import mirror_directions

speech = pathlib.Path("../examples/hello.wav")
samples = audio.read_audio(speech)
model = ha2g_jax.load("demo")
motion = model.generate(speech, seed=0)

# %%
viewer.view(motion, samples)

# %% [markdown]
# ## Side by side
#
# The same speech in another style, and the first motion seen in a mirror. Press `o` to lay one over the other, `b` for
# the bones; the pointer names the joints.

# %%
mirrored = Motion.from_directions(motion.skeleton, mirror_directions(motion.skeleton, motion.directions), motion.fps)
motions = {
    "style 0": motion,
    "style 7": model.generate(speech, seed=0, style_seed=7),
    "style 0 in a mirror": mirrored,
}
viewer.view(motions, samples, height=520)

# %% [markdown]
# ## A page to send
#
# One file that works offline. `ha2g view MOTION ... --audio WAV -o view.html` makes the same.

# %%
page = viewer.write_page(pathlib.Path(tempfile.mkdtemp()) / "styles.html", motions, samples)
print(f"{page.stat().st_size / 1e6:.1f} MB")
