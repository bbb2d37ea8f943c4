"""A recording is cut where nobody speaks, and nothing of it is lost or counted twice."""

import numpy as np
import pytest

from ha2g_jax.data.recording import MOCAP, Recording, SplitReport, to_clips
from ha2g_jax.data.recording import report_as_json as as_json
from ha2g_jax.data.recording import report_as_table as as_table
from ha2g_jax.features.text import Word
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_gesture")
FPS = 15


def make_recording(words: list[Word], seconds: float = 60.0, **more) -> Recording:
    """Someone whose hands never rest."""
    motion = np.random.default_rng(0).normal(0, 0.05, (round(seconds * FPS), SKELETON.num_joints, 3))
    audio = np.linspace(-0.5, 0.5, round(seconds * 16000), dtype=np.float32)
    return Recording("talk", "ada", audio, tuple(words), SKELETON.mean_pose + motion, **more)


def spoken(start: float, end: float) -> list[Word]:
    """Two words a second, one after the other."""
    return [Word("word", float(time), float(time) + 0.5) for time in np.arange(start, end, 0.5)]


def test_cut_in_the_longest_pauses():
    words = spoken(0, 13) + spoken(15, 29) + spoken(32, 44) + spoken(45.5, 60)
    clips, report = to_clips(make_recording(words), SKELETON)
    assert [clip.recording_start for clip in clips] == pytest.approx([0, 14, 30.5, 44.75], abs=0.04)
    assert [clip.id for clip in clips] == ["talk-0", "talk-1", "talk-2", "talk-3"]
    assert sum(len(clip.words) for clip in clips) == len(words)
    assert (report.videos, report.clips, report.kept) == (1, 4, sum(len(clip.window_starts) for clip in clips))


@pytest.mark.parametrize("words", [[], spoken(0, 60), [Word("aah", 0, 60)]])
def test_pieces_follow_one_another(words):
    """Without a transcript, without a pause, or in one long word: all frames are there once, no clip is too long."""
    recording = make_recording(words, confidence=np.ones((900, SKELETON.num_joints), np.float32))
    clips, _ = to_clips(recording, SKELETON, filters=MOCAP._replace(min_words=None), max_seconds=20)
    np.testing.assert_array_equal(np.concatenate([clip.positions for clip in clips]), recording.positions)
    np.testing.assert_array_equal(np.concatenate([clip.audio for clip in clips]), recording.audio)
    for clip in clips:
        assert 34 <= len(clip.positions) <= 300
        assert clip.confidence is not None
        assert len(clip.confidence) == len(clip.positions)
        assert len(clip.audio) == pytest.approx(len(clip.positions) / FPS * 16000, abs=1)
        assert all(0 <= word.start < word.end <= len(clip.positions) / FPS + 1e-9 for word in clip.words)


def test_what_is_left_out_is_counted():
    still = make_recording(spoken(0, 10), 10)._replace(positions=np.tile(SKELETON.mean_pose, (150, 1, 1)))
    clips, report = to_clips(still, SKELETON)
    assert clips == []
    assert report.as_json() == {
        "videos": 1,
        "clips": 1,
        "windows": 12,
        "kept": 0,
        "filtered": {"motion": 12},
        "rejected": {"no window left": 1},
    }
    assert to_clips(make_recording(spoken(0, 2), 2), SKELETON)[1].rejected == {"too short": 1}


def test_reports_add_up():
    first = SplitReport(1, 2, 3, 2, rejected=to_clips(make_recording([], 1), SKELETON)[1].rejected)
    total = first + first
    assert (total.videos, total.clips, total.windows, total.kept, total.rejected["too short"]) == (2, 4, 6, 4, 2)
    assert SplitReport.from_json(total.as_json()) == total
    assert "rejected" not in as_json({"train": SplitReport()})["train"]
    assert "2 clips left out: too short" in as_table({"train": total})
