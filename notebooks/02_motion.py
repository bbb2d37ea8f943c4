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
# # View motion
#
# This notebook shows generated motion in the viewer, several motions side by side, and writes a page that can be sent
# to others. Drag to rotate the figure; space plays, `?` lists the keys (`docs/viewer.md`).

# %%
import pathlib
import tempfile

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

# %%
viewer.view(motion, samples)

# %% [markdown]
# ## Side by side
#
# The same speech in another style, and the first motion mirrored. Press `o` to overlay the motions and `b` to show the
# bones; the names of the joints appear at the pointer.

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
# The page is one file that works offline. `ha2g view MOTION ... --audio WAV -o view.html` writes the same page.

# %%
page = viewer.write_page(pathlib.Path(tempfile.mkdtemp()) / "styles.html", motions, samples)
print(f"{page.stat().st_size / 1e6:.1f} MB")
