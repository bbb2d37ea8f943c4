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
# # Inside the model
#
# HA2G (Liu et al., CVPR 2022) encodes speech on three levels, blends them for each part of the body in a way that
# depends on the speaker, and infers the pose from coarse to fine. This notebook shows each of these steps in the demo
# model of the package: the features of the audio, what the words do in training, the style coordinator, and the
# stages of the pose inferer. `docs/model.md` lists the decisions D1 to D21 that the text names.
#
# The speech is made by the grammar and the synthesiser of the Talk corpus, with a voice that the model does not know,
# because its words and their times are then known exactly.

# %%
from ha2g_jax.files.cache import keep_programs

keep_programs()  # compiled programs are kept for the next run, as the command ha2g does

import itertools

import inspection
import matplotlib.pyplot as plt
import numpy as np

import ha2g_jax
from ha2g_jax import figure
from ha2g_jax.data.talk import grammar
from ha2g_jax.features import audio, spectrum
from ha2g_jax.features import espeak as speech
from ha2g_jax.skeleton import directions_to_positions
from ha2g_jax.synthesis import Style, encode_features

model = ha2g_jax.load("demo")
rng = np.random.default_rng(7)
sentences = " ".join(itertools.islice(grammar.sentences(rng), 4))
samples, words, *_ = speech.say(sentences, speech.sample_voice(rng))
print(f"{len(samples) / audio.SAMPLE_RATE:.1f} s:", " ".join(word.text for word in words))

# %% [markdown]
# ## Three levels of audio
#
# The encoder E_a is one ResNet with three heads (Tables 6 and 7 of the paper): f_low comes from an early block,
# f_high from the last one. Each level has 32 values at each frame of the motion. Below the spectrogram, each level is
# shown as an image, one row for each value, scaled to its own mean and spread. The pauses stand out, most on the
# lowest level; what a single value means cannot be seen, so the next section asks what a level knows.

# %%
seconds = 5.0
features = encode_features(model, samples)
_, axes = plt.subplots(4, sharex=True, figsize=(10, 6.5), height_ratios=(1.4, 1, 1, 1))
mel = spectrum.log_mel(samples)
axes[0].imshow(
    mel, aspect="auto", origin="lower", extent=(0, mel.shape[1] * spectrum.HOP_LENGTH / audio.SAMPLE_RATE, 0, 128)
)
axes[0].set_ylabel("mel band")
for word in words:
    if word.start < seconds - 0.3:
        axes[0].text(word.start, 131, word.text, rotation=40, fontsize=8)
for axis, (name, values) in zip(axes[1:], features._asdict().items(), strict=True):
    scaled = (values - values.mean(axis=0)) / values.std(axis=0)
    axis.imshow(scaled.T, aspect="auto", extent=(0, len(values) / model.fps, 0, 32), vmin=-2, vmax=2, cmap="RdBu_r")
    axis.set_ylabel(f"f_{name}")
axes[-1].set_xlim(0, seconds)
axes[-1].set_xlabel("time (s)")
plt.show()

# %% [markdown]
# ## Words teach the highest level
#
# In training, a text encoder reads the words, and the contrastive loss (Eq. 2) asks that the text feature f_t of a
# moment is more similar to f_high of that moment than to f_high of any other moment, and than to f_low and f_mid of
# any moment at all. Words are not needed to generate motion, but the demo model still has its text encoder, so that
# the result can be seen on speech it has never heard: each matrix compares every word (rows) with the sound at the
# start of every word (columns).

# %%
similar = inspection.word_similarities(model, samples, words)
_, axes = plt.subplots(1, 3, figsize=(13, 4.4))
for axis, (name, values) in zip(axes, similar.items(), strict=True):
    shown = axis.imshow(values, vmin=-1, vmax=1, cmap="RdBu_r")
    found = np.mean(values.argmax(axis=1) == np.arange(len(words)))
    axis.set_title(f"f_{name}: own sound first for {found:.0%}", fontsize=10)
    axis.set_xlabel("sound of word")
axes[0].set_ylabel("word")
plt.colorbar(shown, ax=axes, shrink=0.8)
plt.show()
print(f"chance: {1 / len(words):.1%}")

# %% [markdown]
# The own sound of a word is first clearly more often than by chance for the highest level only: f_mid finds one word
# more than chance. There is no red diagonal: the demo was trained in several parts, and its text encoder is that of the
# first, which no longer fits f_high (see the model card). `ha2g evaluate --data talk` has a second test, a linear probe
# on f_high for the class of a word.
#
# ## The style coordinator
#
# The identity f_id of a speaker decides by the matrix C how much of each audio level each level of the motion gets:
# f_a^h = C[1, h] f_low + C[2, h] f_mid + C[3, h] f_high (Eq. 3). The columns of C sum to 1. Here it is for the 40
# speakers of training, whose styles are stored with the model.

# %%
styles = np.stack(list(model.assets.speakers.values()))
blend = inspection.audio_blend(model, styles)  # (speakers, 3, levels)
parts = ("head, shoulders", "+ upper arms", "+ forearms", "+ palms", "+ fingers", "+ fingertips")
_, axes = plt.subplots(1, 3, figsize=(13, 6), sharey=True)
for axis, values, name in zip(axes, blend.transpose(1, 0, 2), features._fields, strict=True):
    shown = axis.imshow(values, vmin=0, vmax=1, aspect="auto", cmap="viridis")
    axis.set_title(f"f_{name}: {values.mean():.2f} on average", fontsize=10)
    axis.set_xticks(range(len(parts)), parts, rotation=40, ha="right")
axes[0].set_ylabel("speaker")
plt.colorbar(shown, ax=axes, shrink=0.8)
plt.show()

# %% [markdown]
# Each row is a speaker and each column a level of the motion. Rows differ: the blend is a matter of the speaker.
# Columns differ within a row: it is also a matter of the part of the body. The row "Same audio" of Table 4 is the
# ablation in which all columns are equal (`config.model.inferer.coordinator = "tied"`).
#
# ## From coarse to fine
#
# Stage h of the pose inferer sees the pose of stage h - 1 and the blended audio of its own level (Eq. 4), and infers
# the direction vectors of more bones than the stage before. Below are all stages at one moment. Bones that a stage
# does not have yet are drawn in the mean pose.

# %%
speaker = Style(speaker="speaker-03", variation=0)
motion = model.generate(samples, style=speaker)
window, frame = 2, 12
first = window * model.spec.window_stride
seed_pose = motion.directions[first : first + model.spec.num_seed_frames]
stages = inspection.stage_poses(model, samples, model.assets.speakers["speaker-03"], seed_pose, window=window)

# %%
skeleton = model.assets.skeleton
positions = directions_to_positions(skeleton, stages)
view = figure.fit([(positions[:, frame], skeleton)])
_, axes = plt.subplots(1, len(parts), figsize=(15, 3.2))
for axis, pose, part, level in zip(axes, positions[:, frame], parts, skeleton.levels, strict=True):
    axis.imshow(figure.draw_figure(pose, skeleton, figure.DEFAULT_LOOK, 300, 300, view))
    axis.set_title(f"{part}: {len(level)} bones", fontsize=10)
    axis.axis("off")
plt.show()

# %% [markdown]
# The same in numbers: the mean angle between a bone at a stage and the same bone at the last stage, over the frames
# of the window after the seed pose.

# %%
cosines = np.sum(stages * stages[-1:], axis=-1)[:, model.spec.num_seed_frames :]
angles = np.degrees(np.arccos(np.clip(cosines, -1, 1))).mean(axis=1)  # (stages, bones)
new = [sorted(set(level) - set(before)) for before, level in zip([(), *skeleton.levels], skeleton.levels)]
table = np.array([[angles[stage, bones].mean() for bones in new] for stage in range(len(stages))])
_, axis = plt.subplots(figsize=(7, 4.5))
axis.imshow(table, cmap="magma_r", vmin=0)
for (row, column), value in np.ndenumerate(table):
    axis.text(column, row, f"{value:.0f}°", ha="center", va="center", color="white" if value > 15 else "black")
axis.set_xticks(range(len(parts)), parts, rotation=40, ha="right")
axis.set_yticks(range(len(parts)), [f"stage {number}" for number in range(1, 7)])
axis.set_xlabel("bones, by the level that adds them")
plt.show()

# %% [markdown]
# Above the diagonal a stage does not have the bones yet, and the mean pose is up to about 44° off. On the diagonal a
# stage has just added them, and later stages correct them by 18° or less. The rows "Holistic", "w/o hand
# hierarchy" and "w/o body hierarchy" of Table 4 leave levels out (`config.model.inferer.levels`).
