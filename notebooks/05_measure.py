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
# # Measure
#
# This notebook scores generated motion against true motion, with intervals, beside rows that show what each score is
# worth, and shows why the beat consistency of the paper (BC, Eq. 11) is not enough. `docs/metrics.md` defines all
# scores; `ha2g evaluate` prints them for a checkpoint or for folders of motion of any system.
#
# The speech and the true motion are a few minutes of the Talk corpus, with speakers that the demo model does not
# know.

# %%
from ha2g_jax.files.cache import keep_programs

keep_programs()  # compiled programs are kept for the next run, as the command ha2g does

import dataclasses
import pathlib
import tempfile

import matplotlib.pyplot as plt
import numpy as np

import ha2g_jax
from ha2g_jax import metrics
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.talk import build
from ha2g_jax.evaluation.clip_result import from_corpus
from ha2g_jax.evaluation.evaluate import evaluate
from ha2g_jax.evaluation.rows import mean_directions
from ha2g_jax.metrics import sanity
from ha2g_jax.metrics.beats import stops
from ha2g_jax.metrics.beats.stops import THRESHOLD, low_samples
from ha2g_jax.motion.smoothing import smooth

path = pathlib.Path(tempfile.mkdtemp()) / "talk"
build.make_talk(path, speakers=5, minutes=5, seed=7)
corpus, model = Corpus.open(path), ha2g_jax.load("demo")
generated, truth = from_corpus(model, corpus, "train")
print(len(truth), "clips,", sum(clip.num_frames for clip in truth) / corpus.fps, "s")

# %% [markdown]
# ## Scores with intervals
#
# `evaluate` takes the motion of any number of methods. The second one here is the motion of the demo, smoothed over
# half a second, to see which scores notice a loss of detail. An interval is the 95 % percentile interval of bootstrap
# draws of *recordings*; all rows have the same draws.

# %%
smoothed = [dataclasses.replace(clip, directions=smooth(clip.directions, clip.fps, 0.5)) for clip in generated]
section = evaluate({"demo": generated, "demo, smoothed": smoothed}, truth, corpus.skeleton, draws=300)

names = ("beat_consistency", "beat_gain", "beats_per_second", "jerk")
_, axes = plt.subplots(1, len(names), figsize=(14, 3.8), sharey=True)
for axis, name in zip(axes, names, strict=True):
    for place, (row, scores) in enumerate(section["rows"].items()):
        score = scores.get(name)
        if score and score["value"] is not None:
            ends = [score["value"] if score[end] is None else score[end] for end in ("low", "high")]
            axis.plot(ends, [place, place], color="tab:red" if row == sanity.JITTER else "tab:blue")
            axis.plot(score["value"], place, "o", color="tab:red" if row == sanity.JITTER else "tab:blue")
    axis.axvline(section["rows"][sanity.TRUTH][name]["value"], color="gray", linestyle=":")
    metric = metrics.lookup(name)
    axis.set_title(f"{metric.title} ({metric.unit})" if metric.unit else metric.title)
axes[0].set_yticks(range(len(section["rows"])), list(section["rows"]))
axes[0].invert_yaxis()
plt.tight_layout()
plt.show()

# %% [markdown]
# The dotted line is ground truth, which is the value to reach: closer is better, not higher. The rows from *ground
# truth* on are the sanity rows, which stand in every table:
#
# - *mean pose* and *frozen* do not move: whatever they score is what a score gives for nothing.
# - *mismatched speech* is true motion with the speech of another recording: the chance level of alignment.
# - *white jitter* (red) is the mean pose and noise as large as true differences of frames. **It has a higher BC than
#   the true motion**, although it knows nothing of the speech. The other three scores expose it: its beat gain, which
#   compares with mismatched speech, is 0 within its interval, it has more than twice as many motion beats per second
#   as the true motion, and about nine times its jerk.
#
# The demo has the BC of the true motion, but about a third of its beat gain: it stops about as often, but less often
# at the right moments. Smoothing takes away some of its beats and much of its jerk, and lowers BC and beat gain as
# well. So BC is read beside beats per second, jerk and beat gain, or not at all.
#
# The evaluation says this itself, in its flags:

# %%
print("\n".join(section["flags"]))

# %% [markdown]
# ## Why jitter wins BC
#
# A motion beat is a minimum of the angle change rate (Eq. 13), and BC asks only whether each onset of the sound has a
# motion beat near it: BC = 1/n sum_i exp(-d_i² / 2 sigma²), d_i being the time from onset i to the nearest motion
# beat (Eq. 11). Motion that has a beat everywhere has one near every onset.

# %%
clips = [clip.directions for clip in truth]
change = stops.mean_angle_change(corpus.skeleton, clips)
jitter = sanity.rows(clips, mean_directions(clips))[sanity.JITTER]
number, (start, end) = 3, (0.3, 5.8)
_, axes = plt.subplots(2, sharex=True, figsize=(12, 5))
for axis, name, motion in zip(axes, ("ground truth", "white jitter"), (clips[number], jitter[number]), strict=True):
    (rate,) = stops.angle_change_rates(corpus.skeleton, [motion], change)
    times = (np.arange(len(rate)) + 0.5) / corpus.fps
    lows = low_samples(rate, THRESHOLD)
    score = stops.beat_consistency(stops.consistency([rate], [truth[number].onsets], corpus.fps))
    axis.plot(times, rate)
    axis.plot(times[lows], rate[lows], "o", label="motion beats")
    for onset in truth[number].onsets:
        axis.axvline(onset, color="gray", linewidth=0.8)
    axis.set_title(f"{name}: {len(lows) / times[-1]:.1f} beats/s, BC {score:.2f}")
    axis.set_ylabel("angle change rate")
axes[0].legend(loc="upper right")
axes[1].set_xlim(start, end)
axes[1].set_xlabel("time (s); gray lines are onsets of the sound")
plt.show()

# %% [markdown]
# ## Is the difference real?
#
# For two methods or more, the differences from the first are scored on the same draws of recordings. An interval that
# does not contain 0 (*) is hardly an accident of these recordings.

# %%
for difference, scores in section["differences"].items():
    print(difference)
    for name, score in scores.items():
        if score["low"] is not None:
            value, low, high = (score[part] for part in ("value", "low", "high"))
            sure = "" if low <= 0 <= high else "  *"
            print(f"  {metrics.lookup(name).title:16} {value:8.3f} [{low:.3f}, {high:.3f}]{sure}")

# %% [markdown]
# Not shown here: FGD and diversity (Table 1) need a pose auto-encoder that was trained on the corpus, `ha2g train
# --config autoencoder:talk`, and are given to `evaluate` as `autoencoder=PoseFeatures("runs/autoencoder")`. A metric
# of your own is one file, see `docs/metrics.md`.
