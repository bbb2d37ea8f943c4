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
# # Train your own
#
# From a corpus to a checkpoint to motion, at a size that two cores train in about a minute: a few minutes of the Talk
# corpus and the smallest networks (`talk:debug`). The result shows how all parts fit together, not what HA2G can do;
# the last section says what a real training takes.

# %%
from ha2g_jax.files.cache import keep_programs

keep_programs()  # compiled programs are kept for the next run, as the command ha2g does

import json
import pathlib
import tempfile

import matplotlib.pyplot as plt
import numpy as np

import ha2g_jax
from ha2g_jax import figure, launch
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.talk import build
from ha2g_jax.evaluation.clip_result import clip_identity, generate_clip
from ha2g_jax.motion.motion import Motion
from ha2g_jax.train.loop import train

folder = pathlib.Path(tempfile.mkdtemp())
build.make_talk(folder / "talk", speakers=4, minutes=4, seed=1)
corpus = Corpus.open(folder / "talk")
for name, split in corpus.metadata["splits"].items():
    print(f"{name:22} {split['clips']:3} clips {split['windows']:4} windows {split['seconds']:6.1f} s")

# %% [markdown]
# ## Train
#
# A config is a preset, DATA:SIZE, and changes of single settings (`ha2g train --help` lists all of them). These
# two lines are the command (`talk` alone, without `./`, is the default corpus)
#
# ```sh
# ha2g train --config talk:debug --workdir run --config.data.path=./talk --config.train.steps=120 ...
# ```
#
# The identity of a speaker comes from a table here, `model.identity.kind=speakers`, which compiles faster than the
# network that reads images of the speaker.

# %%
changes = {
    "data.path": folder / "talk",
    "model.identity.kind": "speakers",
    "train.steps": 120,
    "train.batch_size": 16,
    "train.learning_rate": 0.003,
    "train.log_every": 5,
    "train.validate_every": 20,
    "train.checkpoint_every": 120,
}
config = launch.load_config("talk:debug", [f"--config.{name}={value}" for name, value in changes.items()])
train(config, folder / "run")
print(*sorted(entry.name for entry in (folder / "run").iterdir()))

# %% [markdown]
# ## Watch the losses
#
# The log, `metrics.jsonl`, has the terms of the objective (Eq. 9) unweighted. `ha2g runs RUN -o report.html`
# draws these curves as a page, and TensorBoard reads the folder `tensorboard`.

# %%
lines = [json.loads(line) for line in (folder / "run" / "metrics.jsonl").read_text().splitlines()]
terms = {
    "huber": "reconstruction (Eq. 5)",
    "contrastive": "contrastive (Eq. 2)",
    "physical": "physical (Eq. 8)",
    "style": "style diverging (Eq. 7)",
    "kld": "KL divergence of the styles",
    "gan": "adversarial (Eq. 6)",
}
_, axes = plt.subplots(2, 3, figsize=(13, 5.5), sharex=True)
for axis, (term, title) in zip(axes.flat, terms.items(), strict=True):
    for prefix, label in (("loss/", "training"), ("validation/loss/", "validation")):
        points = [(line["step"], line[prefix + term]) for line in lines if prefix + term in line]
        axis.plot(*zip(*points, strict=True), label=label, marker="o" if prefix != "loss/" else None)
    axis.set_title(title)
axes[0, 0].legend()
axes[1, 1].set_xlabel("step")
plt.show()

# %% [markdown]
# The reconstruction falls in training and in validation; a longer run on so few minutes would fit them ever more
# closely, and validation would get worse. The style term is negative, because it rewards outputs that differ between
# two identities, and it is 0 in validation, where there is only one speaker. The divergence of the styles rises while
# they move apart.
#
# ## Generate from the checkpoint, and compare with the truth
#
# A workdir is a model. Here is the first clip of the validation split: the true motion, that of the new model, and
# that of the demo model. Both start from the first four true poses (M = 4).

# %%
clip = corpus.clips("val")[0]
motions = {"true": Motion.from_positions(corpus.skeleton, clip.positions, corpus.fps)}
for name, source in {"this model": folder / "run", "demo": "demo"}.items():
    model = ha2g_jax.load(source)
    directions = generate_clip(model, clip, clip_identity(model, clip), 0, start=motions["true"].directions[:4])
    motions[name] = Motion.from_directions(corpus.skeleton, directions, corpus.fps)
wrist = corpus.skeleton.joint("right_wrist")
_, axis = plt.subplots(figsize=(12, 3.5))
for name, motion in motions.items():
    axis.plot(np.arange(motion.num_frames) / motion.fps, -motion.positions[:, wrist, 1], label=name)
axis.set_xlabel("time (s)")
axis.set_ylabel("height of the right wrist (m)")
axis.legend()
plt.show()

# %% [markdown]
# The new model rises and falls around the mean of the true motion; it shakes, and does not reach as far. The demo
# reaches as far, in a take of its own: where the hands of a phrase are does not follow from the speech. The demo shows
# the hand shape of most words that carry a gesture; the new model shows none, as they take longer to learn.

# %%
frames = np.array([20, 60, 100, 120])
view = figure.fit([(motion.positions[frames], corpus.skeleton) for motion in motions.values()])
_, axes = plt.subplots(len(motions), len(frames), figsize=(9, 6.8))
for row, (name, motion) in zip(axes, motions.items(), strict=True):
    for axis, frame in zip(row, frames, strict=True):
        pose = motion.positions[frame]
        axis.imshow(figure.draw_figure(pose, corpus.skeleton, figure.DEFAULT_LOOK, 160, 160, view))
        axis.axis("off")
        axis.set_title(f"{name}, {frame / motion.fps:.1f} s", fontsize=9)
plt.tight_layout()
plt.show()

# %% [markdown]
# ## A real training
#
# | config | on | time |
# |---|---|---|
# | `talk:debug` | two cores | a minute: every part runs |
# | `talk:small` | two cores | hours |
# | `talk:medium` | a GPU | minutes: the size of the demo model, whose card has the command of its first part |
# | `ted_expressive` (the paper) | a GPU | see `docs/performance.md` |
#
# The same command continues a run that was stopped (`docs/training.md`). `06_your_data` trains on your own
# recordings, and `05_measure` scores the result.
