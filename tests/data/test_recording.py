"""A recording is cut where nobody speaks, and windows are dropped for the published reasons, and only for them."""

import collections

import numpy as np
import pytest

from ha2g_jax.data import recording
from ha2g_jax.data.recording import MOCAP, TED, Recording, SplitReport, choose_windows, to_clips
from ha2g_jax.data.recording import report_as_json as as_json
from ha2g_jax.data.recording import report_as_table as as_table
from ha2g_jax.features.text import Word
from ha2g_jax.skeleton import Skeleton, load_skeleton

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
    unusable = SplitReport(rejected=collections.Counter({"unusable recording": 2}))
    assert "2 recordings left out: unusable recording" in as_table({"train": unusable})


FRAMES = 72  # four windows of the TED filters
WORDS = tuple(Word("word", 0.5 * i, 0.5 * i + 0.3) for i in range(12))


@pytest.fixture(params=["ted_expressive", "ted_gesture"])
def skeleton(request: pytest.FixtureRequest) -> Skeleton:
    return load_skeleton(request.param)


def moving(skeleton: Skeleton, frames: int = FRAMES) -> np.ndarray:
    """A person larger than the mean pose who waves the left hand and passes all filters."""
    positions = np.repeat(1.3 * skeleton.mean_pose[None].astype(np.float64), frames, axis=0)
    positions[:, skeleton.joint("left_wrist"), 1] += 0.2 * np.sin(np.arange(frames) / 4)
    return positions


def tilted(skeleton: Skeleton, positions: np.ndarray, degrees: np.ndarray | float) -> np.ndarray:
    """The neck set so that the spine makes that angle with upright in each frame."""
    positions, angle = positions.copy(), np.deg2rad(np.broadcast_to(degrees, len(positions)))
    spine = positions[:, skeleton.joint("spine")]
    upright = 0.2 * np.stack([np.sin(angle), -np.cos(angle), 0 * angle], axis=-1)
    positions[:, skeleton.joint("neck")] = spine + upright
    return positions


def verdicts(skeleton: Skeleton, positions: np.ndarray, words=WORDS, **options) -> list[str]:
    choice = choose_windows(positions, words, skeleton, **options)
    assert choice.filtered.total() == len(choice.verdicts) - len(choice.starts)
    return list(choice.verdicts)


def test_good_windows_start_every_ten_frames(skeleton: Skeleton):
    choice = choose_windows(moving(skeleton), WORDS, skeleton)
    assert choice == ((0, 10, 20, 30), ("kept",) * 4)


@pytest.mark.parametrize(("frames", "windows"), [(0, 0), (41, 0), (42, 1), (51, 1), (52, 2)])
def test_only_whole_windows_count(skeleton: Skeleton, frames: int, windows: int):
    assert verdicts(skeleton, moving(skeleton, frames)) == ["kept"] * windows


def test_words_must_overlap_the_window(skeleton: Skeleton):
    # The first window ends at 2.8 s, the second starts at 0.67 s and ends at 3.47 s.
    words = (Word("a", -0.5, 0.1), Word("b", 2.8, 3.0), Word("c", 3.2, 3.6))
    assert verdicts(skeleton, moving(skeleton), words)[:2] == ["too_few_words", "kept"]
    shifted = tuple(Word(word.text, word.start + 100, word.end + 100) for word in words)
    assert verdicts(skeleton, moving(skeleton), shifted, start_time=100.0)[:2] == ["too_few_words", "kept"]
    assert verdicts(skeleton, moving(skeleton), shifted) == ["too_few_words"] * 4


def test_without_transcript_the_filter_can_be_switched_off(skeleton: Skeleton):
    assert verdicts(skeleton, moving(skeleton), ()) == ["too_few_words"] * 4
    assert verdicts(skeleton, moving(skeleton), (), filters=TED._replace(min_words=None)) == ["kept"] * 4


def test_mean_pose_is_dropped(skeleton: Skeleton):
    for distance, verdict in ((0.019, "pose"), (0.021, "motion")):
        positions = np.repeat(skeleton.mean_pose[None] + distance, FRAMES, axis=0)
        assert verdicts(skeleton, positions) == [verdict] * 4
        assert "pose" not in verdicts(skeleton, positions, filters=TED._replace(min_pose_distance=None))


@pytest.mark.parametrize(
    ("degrees", "verdict"),
    [
        (19.9, "kept"),
        (20.1, "spine angle"),  # the mean is too large
        (-20.1, "spine angle"),
        (np.where(np.arange(FRAMES) % 42 == 5, 29.9, 0.0), "kept"),
        (np.where(np.arange(FRAMES) % 42 == 5, 30.1, 0.0), "spine angle"),  # one frame is too large
    ],
)
def test_leaning_spine_is_dropped(skeleton: Skeleton, degrees: np.ndarray | float, verdict: str):
    positions = tilted(skeleton, moving(skeleton), degrees)
    assert verdicts(skeleton, positions)[0] == verdict
    assert verdicts(skeleton, positions, filters=MOCAP)[0] == "kept"


@pytest.mark.parametrize(("wrist", "other"), [("left_wrist", "right_wrist"), ("right_wrist", "left_wrist")])
def test_motion_of_either_wrist_is_enough(skeleton: Skeleton, wrist: str, other: str):
    positions = np.repeat(1.3 * skeleton.mean_pose[None].astype(np.float64), 42, axis=0)
    assert verdicts(skeleton, positions) == ["motion"]
    # Half the frames at +d, half at -d: variance d^2 on each axis.
    for distance, verdict in ((np.sqrt(0.00139 / 3), "motion"), (np.sqrt(0.00141 / 3), "kept")):
        moved = positions.copy()
        moved[:21, skeleton.joint(wrist)] += distance
        moved[21:, skeleton.joint(wrist)] -= distance
        assert verdicts(skeleton, moved) == [verdict]
        assert verdicts(skeleton, moved, filters=TED._replace(min_wrist_variance=None)) == ["kept"]


def test_first_reason_counts(skeleton: Skeleton):
    still = np.repeat(skeleton.mean_pose[None].astype(np.float64), 42, axis=0)
    assert verdicts(skeleton, still, ()) == ["too_few_words"]
    assert verdicts(skeleton, still) == ["pose"]
    assert verdicts(skeleton, tilted(skeleton, 1.3 * still, 25.0)) == ["spine angle"]
    assert verdicts(skeleton, 1.3 * still) == ["motion"]
    assert set(recording.REASONS) == {"too_few_words", "pose", "spine angle", "motion"}


def test_spine_of_no_length_is_no_number_but_a_reason(skeleton: Skeleton):
    positions = moving(skeleton)
    positions[:, skeleton.joint("neck")] = positions[:, skeleton.joint("spine")]
    assert verdicts(skeleton, positions) == ["spine angle"] * 4
