"""Systems that differ in a known way are ranked as they must be, with intervals of the paired differences."""

import dataclasses
import functools
import json

import numpy as np
import pytest
import soundfile

from ha2g_jax import cli
from ha2g_jax.evaluation.evaluate import evaluate
from ha2g_jax.evaluation.table import as_table
from ha2g_jax.skeleton import normalize


def shaken(clips, skeleton, seed):
    """The motion of a good system: the true one with some noise of low frequency."""
    rng = np.random.default_rng(seed)
    noise = [np.repeat(rng.normal(0, 0.02, (len(clip.directions) // 15 + 1, 1, 3)), 15, axis=0) for clip in clips]
    return [
        dataclasses.replace(clip, directions=normalize(clip.directions + part[: len(clip.directions)]))
        for clip, part in zip(clips, noise, strict=True)
    ]


@pytest.fixture(scope="module")
def section(skeleton, perform, features):
    truth = perform(18, 240)
    late, mean = perform(18, 240, delay=0.3), skeleton.mean_directions
    half = [dataclasses.replace(it, directions=normalize(mean + 0.5 * (it.directions - mean))) for it in truth]
    methods = {"good": shaken(truth, skeleton, 1), "late": shaken(late, skeleton, 2), "half": half}
    return evaluate(methods, truth, skeleton, autoencoder=features, draws=200)


@pytest.mark.parametrize(
    ("pair", "metric", "sign"),
    [
        ("late - good", "beat_gain", -1),
        ("late - good", "joint_mae", 1),
        ("half - good", "l1_diversity", -1),
        ("half - good", "acceleration", -1),
        ("half - good", "joint_mae", 1),
        ("half - good", "fgd", 1),
    ],
)
def test_a_difference_has_its_sign_in_the_whole_interval(section, pair, metric, sign):
    score = section["differences"][pair][metric]
    bounds = sorted(sign * score[end] for end in ("low", "high"))
    assert 0 < bounds[0] <= sign * score["value"] <= bounds[1]


def test_a_delay_does_not_change_how_much_a_system_moves(section):
    score = section["differences"]["late - good"]["l1_diversity"]
    assert abs(score["value"]) < 0.05 * section["rows"]["good"]["l1_diversity"]["value"]


def poses(clip: int, delay: float, scale: float, frames: int = 450) -> np.ndarray:
    """SMPL-X poses at 30 frames per second whose trunk circles and slows down `delay` s after `clicks`."""
    times, onsets = np.arange(frames) / 30, clicks(clip)
    stops = np.exp(-np.square(times[:, None] - onsets - delay) / (2 * 0.08**2)).sum(axis=1)
    phase = np.cumsum(1 - 0.7 * np.clip(stops, 0, 1)) / 30 * 4
    angles = np.zeros((frames, 55, 3))
    angles[:, 3] = 0.3 * scale * np.stack([np.sin(phase + clip), 0 * phase, np.cos(phase + clip)], axis=-1)
    angles[:, 16, 2] -= 1.0
    angles[:, 17, 2] += 1.0
    return angles.reshape(frames, 165)


def clicks(clip: int) -> np.ndarray:
    return np.cumsum(np.random.default_rng(100 + clip).uniform(0.9, 1.4, 11))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("systems")
    systems = {"true": (0.0, 1.0), "good": (0.0, 0.97), "late": (0.3, 0.97), "half": (0.0, 0.5)}
    for name, (delay, scale) in systems.items():
        (root / name).mkdir()
        for clip in range(6):
            arrays = {"poses": poses(clip, delay, scale), "trans": np.zeros((450, 3)), "mocap_frame_rate": 30}
            np.savez(root / name / f"talk{clip}.npz", **arrays)
            if name == "true":
                sound = np.zeros(15 * 16000, np.float32)
                for onset in clicks(clip):
                    start = int(onset * 16000)
                    sound[start : start + 1600] += np.hanning(3200)[1600:] * np.sin(np.arange(1600) * 0.3)
                soundfile.write(root / name / f"talk{clip}.wav", 0.5 * sound, 16000)
    return root


def test_the_protocol_of_beat2_ranks_systems_of_smplx_files(folders, capsys, monkeypatch):
    monkeypatch.setattr("ha2g_jax.evaluation.motion_folders.DRAWS", 100)
    monkeypatch.setattr("ha2g_jax.evaluation.scoring.evaluate", functools.partial(evaluate, draws=10))
    motions = [part for name in ("good", "late", "half") for part in ("--motion", str(folders / name))]
    arguments = ["evaluate", *motions, "--reference", str(folders / "true"), "--protocol", "beat2"]
    assert cli.main([*arguments, "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    [section] = results["sections"].values()
    rows = section["beat2"]["rows"]
    assert list(rows) == ["good", "late", "half", "ground truth", "mismatched speech", "late - good", "half - good"]
    assert rows["late - good"]["beat2_bc"]["high"] < 0
    assert rows["half - good"]["beat2_l1div"]["high"] < 0
    spread = [rows[name]["beat2_l1div"]["value"] for name in ("half", "ground truth")]
    assert spread[0] / spread[1] == pytest.approx(0.5, abs=0.05)
    assert rows["ground truth"]["beat2_bc"]["value"] > rows["mismatched speech"]["beat2_bc"]["value"]
    assert "Protocol BEAT2" in as_table(results)
