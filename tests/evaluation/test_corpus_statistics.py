"""The numbers of a corpus against counts by hand and against numpy on all frames at once."""

import dataclasses
import json

import numpy as np
import pytest
from fixtures.corpora import write_corpus

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.evaluation.corpus_statistics import ANGLE_EDGES, as_table, summarise
from ha2g_jax.skeleton import load_skeleton


@pytest.fixture(scope="module")
def summary(tiny_talk):
    return summarise(tiny_talk)


def test_counts(summary, tiny_talk):
    corpus = Corpus.open(tiny_talk)
    everything = [clip for split in corpus.splits for clip in corpus.clips(split)]
    known = {word.text for clip in corpus.clips("train") for word in clip.words}
    for split, counts in {**summary["splits"], "total": summary["total"]}.items():
        clips = everything if split == "total" else list(corpus.clips(split))
        words = [word.text for clip in clips for word in clip.words]
        assert counts["clips"] == len(clips) > 0
        assert counts["recordings"] == len({clip.recording for clip in clips})
        assert counts["speakers"] == len({clip.speaker for clip in clips})
        assert counts["windows"] == sum(len(clip.window_starts) for clip in clips)
        assert counts["hours"] == pytest.approx(sum(len(clip.positions) for clip in clips) / 15 / 3600)
        assert counts["words_per_minute"] == pytest.approx(len(words) / counts["hours"] / 60)
        assert counts["vocabulary"] == len(set(words))
        assert counts["unknown_words"] == pytest.approx(np.mean([word not in known for word in words]))
        assert counts["reference_images"] == 7 * len(clips)
        assert counts["confidence"] is counts["both_hands"] is None
    assert summary["splits"]["train"]["unknown_words"] == 0
    assert sum(summary["clip_seconds"]) == sum(summary["clip_pace"]) == len(everything)


def test_motion_of_training(summary, tiny_talk):
    """Inner angles, bone lengths and wrist speed of all frames in windows, computed in another way."""
    corpus, skeleton = Corpus.open(tiny_talk), load_skeleton("ted_expressive")
    bends, elbows, steps = [], [], []
    for clip in corpus.clips("train"):
        positions = clip.positions[: max(clip.window_starts) + 34].astype(np.float64)  # windows follow without a gap
        shoulder, elbow, wrist = (
            positions[:, skeleton.joint(f"left_{name}")] for name in ("shoulder", "elbow", "wrist")
        )
        upper, lower = shoulder - elbow, wrist - elbow
        cosine = (upper * lower).sum(-1) / np.linalg.norm(upper, axis=-1) / np.linalg.norm(lower, axis=-1)
        bends.append(np.rad2deg(np.arccos(cosine)))
        elbows.append(np.linalg.norm(upper, axis=-1))
        wrists = positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]]
        steps.append(np.linalg.norm(np.diff(wrists, axis=0), axis=-1).ravel() * 15)
    training = summary["training"]
    bend, speed = np.concatenate(bends), np.concatenate(steps)
    assert training["frames"] == len(bend)
    joint = training["joints"]["left_elbow"]
    assert joint["corpus"]["mean"] == pytest.approx(bend.mean(), abs=0.01)
    assert joint["corpus"]["std"] == pytest.approx(bend.std(), abs=0.01)
    np.testing.assert_allclose(joint["histogram"], np.histogram(bend, ANGLE_EDGES)[0], atol=2)
    assert joint["published"] == pytest.approx({"mean": 80.3, "std": 18.8}, abs=0.1)
    assert joint["table_10"] == {"mean": 75.1, "std": 7.30}
    bone = training["bones"]["left_shoulder - left_elbow"]
    assert bone["mean"] == pytest.approx(np.concatenate(elbows).mean(), abs=1e-4)
    assert bone["published"] == pytest.approx(0.36)
    assert training["wrist_speed"]["mean"] == pytest.approx(speed.mean(), rel=1e-3)
    assert training["wrist_speed"]["median"] == pytest.approx(np.median(speed), abs=0.02)
    pair = training["angles"]["left_elbow - left_wrist"]
    assert pair["mean"] == pytest.approx(180 - bend.mean(), abs=0.01)
    assert len(training["angles"]) == 41


@pytest.fixture
def estimated(tiny_talk, tmp_path):
    """Two clips of test alone: of the first one in four frames has a hand unseen, the second is seen nowhere."""
    clips = Corpus.open(tiny_talk).clips("train")
    sure = np.ones(clips[0].positions.shape[:2], np.float32)
    sure[::4, 8] = 0.1
    unsure = np.zeros(clips[1].positions.shape[:2], np.float32)
    report = {"test": {"videos": 2, "clips": 3, "windows": 20, "kept": 9, "filtered": {"motion": 11}}}
    metadata = {"name": "seen", "import": report, "failed": [{"video": "x", "reason": "no sound"}]}
    path = tmp_path / "seen"
    test = [dataclasses.replace(clip, confidence=seen) for clip, seen in zip(clips, (sure, unsure))]
    return write_corpus(path, {"train": [], "test": test}, skeleton="ted_expressive", metadata=metadata)


def test_confidence_and_no_training(estimated):
    summary = summarise(estimated)
    first, second = (len(clip.positions) for clip in Corpus.open(estimated).clips("test"))
    assert summary["total"]["both_hands"] == pytest.approx((first - len(range(0, first, 4))) / (first + second))
    assert 0.5 * first / (first + second) < summary["total"]["confidence"] < first / (first + second)
    assert summary["splits"]["train"]["clips"] == 0
    assert summary["training"] is None
    assert summary["total"]["unknown_words"] is None
    assert summary["failed"] == [{"video": "x", "reason": "no sound"}]
    table = as_table(summary)
    assert "11 windows left out: motion" in table
    assert "frames with both hands" in table
    assert "unknown" not in table


def test_table_is_aligned_and_json_is_json(summary):
    assert json.loads(json.dumps(summary)) == summary
    lines = as_table(summary).splitlines()
    block = lines[lines.index("") + 1 :][:10]
    assert block[0].split() == [*summary["splits"], "total"]
    assert len({len(line) for line in block}) == 1
