"""A folder like BEAT2's becomes a corpus; what is broken in it is counted and left out."""

import logging

import numpy as np
import pytest
import soundfile
from fixtures.transcripts import text_grid

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.importers.mocap import ImportOptions, import_smplx
from ha2g_jax.motion.readers.smplx_body import JOINTS, template
from ha2g_jax.skeleton import load_skeleton

SECONDS = 8
WORDS = ["we", "move", "both", "hands", "up", "and", "down", "again"]


def _motion(path, **changes) -> None:
    """Somebody whose hanging arms swing ahead and back at 30 frames a second."""
    swing = np.sin(2 * np.pi * 0.5 * np.arange(30 * SECONDS) / 30)
    poses = np.zeros((len(swing), 55, 3))
    poses[:, JOINTS.index("left_shoulder"), 2] = -1.3
    poses[:, JOINTS.index("right_shoulder"), 2] = 1.3
    poses[:, JOINTS.index("left_elbow"), 1] = -1 + 0.8 * swing
    poses[:, JOINTS.index("right_elbow"), 1] = 1 - 0.8 * swing
    arrays = {
        "poses": poses.reshape(len(swing), -1),
        "trans": np.zeros((len(swing), 3)),
        "betas": np.zeros(300),
        "expressions": np.zeros((len(swing), 100)),
        "gender": np.array("neutral", object),
        "model": np.array("smplx2020"),
        "mocap_frame_rate": np.array(30),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, **(arrays | changes))


def _speech(sound, words) -> None:
    for path in (sound, words):
        path.parent.mkdir(parents=True, exist_ok=True)
    noise = 0.1 * np.random.default_rng(0).standard_normal(16000 * SECONDS)
    soundfile.write(sound, noise, 16000)
    words.write_text(text_grid(("words", [(number, number + 1, word) for number, word in enumerate(WORDS)])))


@pytest.fixture
def beat(tmp_path):
    """Two good recordings and a broken one, in the folders of BEAT2."""
    root = tmp_path / "beat_english"
    for name in ("2_scott_0_1_1", "4_lawrence_0_2_2"):
        _motion(root / "smplxflame_30" / f"{name}.npz")
        _speech(root / "wave16k" / f"{name}.wav", root / "textgrid" / f"{name}.TextGrid")
    (root / "smplxflame_30" / "6_carla_0_3_3.npz").write_bytes(b"PK\x03\x04 cut off")
    return root


def test_a_folder_like_beat2s_becomes_a_corpus(beat, tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        report = import_smplx(beat, tmp_path / "out", ImportOptions(licence="for research"))["train"]
    assert (report.videos, dict(report.rejected)) == (2, {"unusable recording": 1})
    assert report.kept > 0
    assert "6_carla_0_3_3.npz is not a whole .npz file" in caplog.text
    corpus = Corpus.open(tmp_path / "out")
    assert corpus.speakers == ("scott", "lawrence")
    assert corpus.metadata["motion"] == {"poses, y up": 2}
    assert corpus.metadata["import"]["train"] == report.as_json()
    assert corpus.metadata["licence"] == "for research"
    clip = corpus.clips("train")[0]
    assert (clip.recording, clip.words[3].text) == ("2_scott_0_1_1", "hands")
    skeleton = load_skeleton("ted_expressive")
    elbow, wrist = (clip.positions[:, skeleton.joint(f"left_{part}")] for part in ("elbow", "wrist"))
    forearm = wrist - elbow
    np.testing.assert_allclose(np.linalg.norm(forearm, axis=1), 0.26, atol=1e-5)
    # Ahead when the elbow is bent by 1.8, which is at the ends of the swing's troughs.
    angles = np.arccos(np.clip(forearm[:, 1] / 0.26, -1, 1))
    assert angles.max() > 1.7
    assert (forearm[:, 2] < 0.0).all()


def test_the_sound_that_is_named_is_that_of_a_single_file(tmp_path):
    """Sound of the same name in another folder does not take its place."""
    name = "2_scott_0_1_1"
    _motion(tmp_path / "in" / "motion" / f"{name}.npz")
    _speech(tmp_path / "in" / "wave16k" / f"{name}.wav", tmp_path / "in" / "textgrid" / f"{name}.TextGrid")
    soundfile.write(tmp_path / "mine.wav", np.full(16000 * SECONDS, 0.25), 16000)
    options = ImportOptions(audio=tmp_path / "mine.wav", with_words=False)
    import_smplx(tmp_path / "in", tmp_path / "out", options)
    (clip,) = Corpus.open(tmp_path / "out").clips("train")
    np.testing.assert_allclose(clip.audio, 0.25, atol=1e-3)


def test_sound_and_words_of_motion_of_the_same_name_are_not_taken(tmp_path, caplog):
    monday, tuesday = (tmp_path / "in" / day / "take" for day in ("monday", "tuesday"))
    for take in (monday, tuesday):
        _motion(take.with_suffix(".npz"))
        _speech(take.with_suffix(".wav"), take.with_suffix(".TextGrid"))
    monday.with_suffix(".TextGrid").unlink()
    times = (f"00:00:0{number},000 --> 00:00:0{number + 1},000" for number in range(SECONDS))
    texts = [f"1\n{time}\n{word}\n" for time, word in zip(times, reversed(WORDS), strict=True)]
    monday.with_suffix(".srt").write_text("\n".join(texts))
    import_smplx(tmp_path / "in", tmp_path / "out")
    first, second = Corpus.open(tmp_path / "out").clips("train")
    assert (first.words[0].text, second.words[0].text) == ("again", "we")
    monday.with_suffix(".wav").unlink()
    with caplog.at_level(logging.WARNING):
        import_smplx(tmp_path / "in", tmp_path / "without")
    assert "monday/take.npz has no audio" in caplog.text


def test_frames_that_a_file_marks_as_bad_are_left_out(tmp_path):
    _speech(tmp_path / "in" / "a.wav", tmp_path / "in" / "a.TextGrid")
    _motion(tmp_path / "in" / "a.npz", is_good=np.arange(30 * SECONDS) < 30 * 4)
    import_smplx(tmp_path / "in", tmp_path / "out")
    (clip,) = Corpus.open(tmp_path / "out").clips("train")
    assert len(clip.positions) == 15 * 4


def test_a_folder_of_joint_positions_needs_its_rate(tmp_path):
    """ExPose writes an array of joints for each take, which does not say its rate."""
    joints = np.tile(template().points[:55], (SECONDS * 30, 1, 1))
    joints[:, JOINTS.index("left_wrist"), 1] += 0.15 * np.sin(np.arange(len(joints)) / 6)
    _speech(tmp_path / "in" / "talk.wav", tmp_path / "in" / "talk.TextGrid")
    np.save(tmp_path / "in" / "talk.npy", joints)
    with pytest.raises(UserError, match=r"talk\.npy: no frame rate in it .* \(--source-fps\)"):
        import_smplx(tmp_path / "in", tmp_path / "out")
    import_smplx(tmp_path / "in", tmp_path / "out", source_fps=30)
    (clip,) = Corpus.open(tmp_path / "out").clips("train")
    assert len(clip.positions) == SECONDS * 15 and len(clip.words) == len(WORDS)
