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
# # Your data
#
# From recordings to a corpus to training, for motion capture in BVH and for videos. `docs/data.md` describes all
# formats (TED, SMPL-X, BEAT2 and transcripts among them).
#
# You need for each recording a motion file and its sound, and for HA2G the words with their times: a TextGrid,
# subtitles or a table, or a plain text that is aligned. So that this notebook runs anywhere, it makes such recordings
# itself: two speakers of the Talk corpus, exported as BVH on the bones of Mixamo, as another program would. Replace
# the folder `recordings` by yours.

# %%
from ha2g_jax.files.cache import keep_programs

keep_programs()  # compiled programs are kept for the next run, as the command ha2g does

import csv
import json
import pathlib
import tempfile

import matplotlib.pyplot as plt
import numpy as np
import soundfile

from ha2g_jax import launch
from ha2g_jax.data import recording, regroup, validation
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.talk import build
from ha2g_jax.evaluation import corpus_statistics as statistics
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.importers.mocap import import_bvh
from ha2g_jax.motion import formats
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.train.loop import train

folder = pathlib.Path(tempfile.mkdtemp())
build.make_talk(folder / "talk", speakers=3, minutes=3, seed=3)
talk = Corpus.open(folder / "talk")
for clip in talk.clips("train"):
    stem = folder / "recordings" / clip.speaker / clip.id
    stem.parent.mkdir(parents=True, exist_ok=True)
    motion = Motion.from_positions(talk.skeleton, clip.positions, talk.fps)
    formats.export(motion, stem.with_suffix(".bvh"), rig="mixamo")
    soundfile.write(stem.with_suffix(".wav"), clip.audio, SAMPLE_RATE)
    with stem.with_suffix(".csv").open("w", newline="") as file:
        csv.writer(file).writerows(
            [("start", "end", "word"), *((word.start, word.end, word.text) for word in clip.words)]
        )
for path in sorted((folder / "recordings").rglob("*.*"))[:6]:
    print(path.relative_to(folder))

# %% [markdown]
# ## Look at one file first
#
# `read_motion` reads a file of any kind and says how it understood it. A new skeleton needs a joint map, a JSON file
# with an entry for each joint; Mixamo, ZeroEGGS, BEAT, GENEA and the exports of this package are known. Here the motion
# that was exported is known too, so the import can be checked: the figure shows how far each bone is from the truth.

# %%
clip = talk.clips("train")[0]
stem = folder / "recordings" / clip.speaker / clip.id
read = read_motion(stem.with_suffix(".bvh"), skeleton="ted_expressive")
print(json.dumps(read.meta["read_from"], indent=1))

true = Motion.from_positions(talk.skeleton, clip.positions, talk.fps)
cosines = np.sum(read.directions * true.directions, axis=-1)
degrees = np.degrees(np.arccos(np.clip(cosines, -1, 1))).mean(axis=0)
names = [talk.skeleton.joints[child] for _, child in talk.skeleton.bones]
_, axis = plt.subplots(figsize=(12, 3))
axis.bar(names, degrees)
axis.tick_params(axis="x", rotation=90, labelsize=8)
axis.set_ylabel("mean angle to the truth (°)")
plt.show()

# %% [markdown]
# Arms and fingers come back as they were. The bones from the wrist to the knuckles are those of the hand of Mixamo,
# whose thumb begins at another place (12°). BVH has no face, so nose, eyes and ears are fixed points of the head,
# which is assumed to look ahead on average; and the motion is rotated once so that the person faces the viewer on
# average.
#
# ## Import
#
# The sound and the words lie beside each motion file and have its name; the folder is the speaker. A window is left
# out for a reason that the report counts. The command is `ha2g data import recordings corpus`.

# %%
report = import_bvh(folder / "recordings", folder / "imported")
print(recording.report_as_table(report))

# %% [markdown]
# A validation split is needed for the best checkpoint. `regroup.divide` (`ha2g data split`) never divides a
# recording. Then the corpus is checked, and its statistics are shown; `ha2g data inspect corpus` writes them as a
# page, with clips to watch and the angles beside those of the paper (Table 10).

# %%
regroup.divide(folder / "imported", folder / "corpus", fractions={"train": 0.8, "val": 0.2})
print("errors:", validation.examine(folder / "corpus").findings)
summary = statistics.summarise(folder / "corpus")
for row in [*statistics.split_rows(summary), [], *statistics.joint_rows(summary["training"])]:
    print("".join(f"{cell:<24}" if column == 0 else f"{cell:>12}" for column, cell in enumerate(row)))

# %% [markdown]
# The speeds of the wrists say at a glance whether units and frame rate are right: people who gesture move their
# wrists at a few tenths of a metre per second on average. A wrong unit shows as speeds ten or a hundred times as
# large.

# %%
speed = summary["training"]["wrist_speed"]
counts = np.array(speed["histogram"])
_, axis = plt.subplots(figsize=(8, 3))
axis.stairs(counts / counts.sum(), np.linspace(0, 4, len(counts) + 1), fill=True)
axis.axvline(speed["mean"], color="black", label=f"mean {speed['mean']:.2f} m/s")
axis.set_xlim(0, 2)
axis.set_xlabel("speed of a wrist (m/s)")
axis.set_ylabel("fraction of frames")
axis.legend()
plt.show()

# %% [markdown]
# ## Train on it
#
# The preset `bvh` takes the identity of a speaker from a table, since motion capture has no images. Any method of
# Table 1 trains on the corpus. A few steps of Speech2Gesture, which compiles fastest, show that all is in place; HA2G
# is `bvh:small` on two cores, and `bvh` on a GPU. `04_train_your_own` follows a run of HA2G.

# %%
changes = {
    "data.path": folder / "corpus",
    "train.steps": 20,
    "train.batch_size": 8,
    "train.log_every": 5,
    "train.validate_every": 10,
    "train.checkpoint_every": 20,
}
config = launch.load_config("speech2gesture:bvh:debug", [f"--config.{name}={value}" for name, value in changes.items()])
train(config, folder / "run")
for line in map(json.loads, (folder / "run" / "metrics.jsonl").read_text().splitlines()):
    print(line["step"], {name: round(value, 3) for name, value in line.items() if name.endswith("loss/l1")})

# %% [markdown]
# ## Videos
#
# Videos of people who speak become a corpus by the pipeline of the paper (Appendix A): shots, a pose estimator,
# filters, words. The estimator is installed once, in an environment of its own (400 MB), so this notebook does not
# run it:
#
# ```sh
# pip install 'ha2g-jax[import]'
# ha2g data build-video --install
# ha2g data build-video videos/ corpus --overlay overlay     # overlay/ shows the skeleton on each speaker
# ha2g data inspect corpus
# ha2g train --config video:small --workdir run --config.data.path=corpus
# ```
#
# From there on all is as above: `regroup`, `validation`, `statistics` and `train` read any corpus. The preset
# `video` learns the identity of a speaker from the images that the corpus stores.
