"""Checks of a package with the recipes of docs/extending.md, run by test_extending.py in its folder.

python extended_package.py COMMANDS prints {recipe: "" or what failed} as JSON.
"""

import functools
import json
import pathlib
import runpy
import sys
import traceback

import jax
import numpy as np
import soundfile

import ha2g_jax
from ha2g_jax import launch
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import presets
from ha2g_jax.data.windows import Windows
from ha2g_jax.evaluation.clip_result import ClipResult
from ha2g_jax.evaluation.evaluate import evaluate
from ha2g_jax.evaluation.table import section_table
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods import build
from ha2g_jax.methods.ha2g import losses
from ha2g_jax.methods.method import example_batch
from ha2g_jax.metrics import METRICS
from ha2g_jax.motion import formats
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton, normalize
from ha2g_jax.synthesis import Model
from ha2g_jax.train.inputs import open_corpus, open_windows
from ha2g_jax.train.objective import build_objective, init_state
from ha2g_jax.train.step import train_step

SKELETON = load_skeleton("ted_gesture")


def debug_objective(changes, method="ha2g"):
    config = presets.make("ted_gesture", "debug", method, changes)
    return config, build_objective(config, SKELETON, 3, 2)


def step_shapes(objective):
    """The metrics of one training step, as shapes."""
    state = jax.eval_shape(functools.partial(init_state, objective), jax.random.key(0))
    step = functools.partial(train_step, objective)
    return jax.eval_shape(step, state, example_batch(objective.spec), jax.random.key(0))[1]


def loss_term():
    _, objective = debug_objective({"loss.ha2g.weights.velocity": 3.0})
    velocity = getattr(losses, "velocity")  # noqa: B009, as a checker of types knows the package without the recipe
    assert objective.weights.velocity == 3
    assert step_shapes(objective)["loss/velocity"].shape == ()
    still, moving = np.zeros((2, 5, 6), np.float32), np.arange(60, dtype=np.float32).reshape(2, 5, 6)
    assert (velocity(moving, moving + 1), velocity(moving, still)) == (0, 6)
    assert ha2g_jax.load("demo").speakers


def audio_encoder():
    _, objective = debug_objective({"model.audio.kind": "conv", "model.audio.conv.channels": 4})
    assert type(objective.spec.generator.audio).__name__ == "ConvAudioEncoder"
    assert "loss/contrastive" in step_shapes(objective)


def method():
    config, objective = debug_objective({"model.denoising_steps": 3}, "diffusion")
    spec = objective.spec
    state, key = init_state(objective, jax.random.key(0)), jax.random.key(1)
    random = np.random.default_rng(0)
    noise = random.normal(0, 0.2, (2, spec.num_frames, SKELETON.num_bones, 3))
    batch = {
        "audio": random.normal(0, 0.1, (2, 36_267)).astype(np.float32),
        "directions": normalize((SKELETON.mean_directions + noise).astype(np.float32)),
        "speaker": np.zeros(2, np.int32),
    }
    step = jax.jit(functools.partial(train_step, objective))
    before = state.generator.params["decoder"]["linear_2"]["kernel"]
    state, _ = step(state, batch, key)
    state, metrics = step(state, batch, key)
    assert state.is_finite and state.step == 2 and metrics["loss/denoising"] > 0
    assert (state.generator.params["decoder"]["linear_2"]["kernel"] != before).any()

    start = SKELETON.mean_directions[None].repeat(spec.num_seed_frames, axis=0)
    assets = Assets(SKELETON, Vocabulary(("one",)), {}, normalize(start[None].astype(np.float32)), "0" * 16)
    model = Model(spec, state.model, assets, config)
    speech = random.normal(0, 0.1, 48_000).astype(np.float32)
    first, again, other = (model.generate(speech, seed=seed).directions for seed in (0, 0, 1))
    assert first.shape == (45, SKELETON.num_bones, 3) and np.isfinite(first).all()
    assert (first == again).all() and np.abs(first - other).max() > 0.1  # the seed pose is the same for all seeds


def data_set():
    skeleton = load_skeleton("ted_expressive")
    folder = pathlib.Path("recordings", "ada")
    folder.mkdir(parents=True)
    time = np.arange(60) / 15
    positions = skeleton.mean_pose[None].repeat(60, axis=0)
    hands = [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]
    positions[:, hands, 1] += 0.1 * np.sin(2 * np.pi * time)[:, None]
    np.savez(folder / "one.npz", positions=positions)
    soundfile.write(folder / "one.wav", np.random.default_rng(0).normal(0, 0.1, 64_000), 16_000)
    lines = "".join(f"{start / 2}\t{start / 2 + 0.4}\tword\n" for start in range(8))
    (folder / "one.tsv").write_text(f"start\tend\tword\n{lines}")
    runpy.run_path("experiments/import_points.py")["main"]("recordings", "corpora/points")

    config = launch.load_config("bvh:debug", ["--config.data.path=corpora/points"])
    corpus = open_corpus(config)
    vocabulary = corpus.vocabulary()
    spec = build(config, corpus.skeleton, len(vocabulary), len(corpus.speakers_of("train")))
    windows = open_windows(config, spec, corpus, "train")
    assert isinstance(windows, Windows) and len(windows) >= 2
    example = windows[0]
    assert example["directions"].shape == (34, 42, 3) and example["mel"].shape == (128, 70)
    assert example["words"].max() > 0 and tuple(corpus.speakers_of("train")) == ("ada",)


def metric():
    random = np.random.default_rng(0)
    waves = 0.3 * np.sin(np.arange(90)[:, None, None] / 3 + random.uniform(0, 6, (1, SKELETON.num_bones, 3)))
    directions = normalize((SKELETON.mean_directions + waves).astype(np.float32))
    onsets = np.arange(1, 6) * 1.0
    truth = [ClipResult(f"clip{n}", f"clip{n}", np.roll(directions, n, axis=0), 15.0, onsets) for n in range(2)]
    section = evaluate({"mine": truth}, truth, SKELETON, draws=10)
    scores = {row: values["hand_speed"]["value"] for row, values in section["rows"].items() if "hand_speed" in values}
    assert scores["mine"] == scores["ground truth"] > 0 == scores["frozen"]
    assert METRICS["hand_speed"].heading == "hand speed m/s" in section_table(section)


def rig():
    skeleton = load_skeleton("ted_expressive")
    directions = normalize(skeleton.mean_directions[None].repeat(4, axis=0))
    motion = Motion.from_directions(skeleton, directions, 15, {})
    formats.export(motion, "puppet.json", rig="puppet")
    names = [joint["name"] for joint in json.loads(pathlib.Path("puppet.json").read_text())["joints"]]
    assert names == ["Body", "Head", "ArmL", "ArmR"]
    formats.export(motion, "puppet.bvh", rig="puppet")
    assert "JOINT ArmL" in pathlib.Path("puppet.bvh").read_text()


def commands():
    for config, flags in json.loads(sys.argv[1]):
        assert launch.load_config(config, flags).train.steps > 1, config


CHECKS = {
    "a loss term": loss_term,
    "an audio encoder": audio_encoder,
    "a method": method,
    "a data set": data_set,
    "a metric": metric,
    "a rig": rig,
    "commands": commands,
}


def main():
    folder = pathlib.Path.cwd()
    assert pathlib.Path(ha2g_jax.__file__).is_relative_to(folder), f"{ha2g_jax.__file__} is not the changed package"
    results = {}
    for name, check in CHECKS.items():
        try:
            check()
            results[name] = ""
        except Exception:
            results[name] = traceback.format_exc()
    sys.stdout.write(f"{json.dumps(results)}\n")


if __name__ == "__main__":
    main()
