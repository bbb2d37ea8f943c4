"""Files in the layouts of Seamless Interaction and Embody 3D become corpora with the motion that was written."""

import json
import re

import numpy as np
import pytest
import soundfile
from scipy.spatial.transform import Rotation

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.importers.mocap import ImportOptions, import_smplx
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.readers.smplx import read_smplx
from ha2g_jax.motion.readers.smplx_body import JOINTS, template
from ha2g_jax.skeleton import load_skeleton

SECONDS = 12
FRAMES = 30 * SECONDS
BAD = slice(150, 180)  # frames that were not tracked: the sixth second
GOOD = 1 - np.isin(np.arange(FRAMES), range(BAD.start, BAD.stop))[:, None].astype(np.float32)
SEAMLESS = "V00_S0809_I00000582_P0947"
CAPTURE = "c--20250108--1300--DXG448--BWW760--pilot--MotionPrior--ACTING_Adult_Birthday_--103301-103661"


@pytest.fixture(scope="module")
def poses():
    """Axis-angles (FRAMES, 55, 3) of somebody whose forearms swing."""
    swing = np.sin(2 * np.pi * 0.5 * np.arange(FRAMES) / 30)
    poses = np.zeros((FRAMES, 55, 3))
    poses[:, JOINTS.index("left_shoulder"), 2] = -1.3
    poses[:, JOINTS.index("right_shoulder"), 2] = 1.3
    poses[:, JOINTS.index("left_elbow"), 1] = -1 + 0.8 * swing
    poses[:, JOINTS.index("right_elbow"), 1] = 1 - 0.8 * swing
    poses[:, JOINTS.index("right_index_1"), 2] = 0.5
    return poses


@pytest.fixture(scope="module")
def expected(poses, tmp_path_factory):
    """The motion as the plain layout gives it."""
    path = tmp_path_factory.mktemp("plain") / "plain.npz"
    trans = np.linspace([0, 0, 0], [0.1, 0, 0], FRAMES)
    np.savez(path, poses=poses.reshape(FRAMES, -1), trans=trans, mocap_frame_rate=30)
    return read_smplx(path, load_skeleton("ted_expressive"), template(), fps=15).positions


def _sound(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(path, 0.1 * np.random.default_rng(0).standard_normal(16000 * SECONDS), 16000)


@pytest.fixture
def seamless(poses, tmp_path):
    """A folder of Seamless Interaction with a person whom a camera saw: y down, centimetres."""
    folder = tmp_path / "seamless" / "improvised" / "dev" / "0000" / "0005"
    _sound(folder / f"{SEAMLESS}.wav")
    turned = poses.copy()
    turned[:, 0] = (Rotation.from_rotvec([np.pi, 0, 0]) * Rotation.from_rotvec(poses[:, 0])).as_rotvec()
    np.savez(
        folder / f"{SEAMLESS}.npz",
        **{
            "smplh:global_orient": turned[:, 0].astype(np.float32),
            "smplh:body_pose": turned[:, 1:22].astype(np.float32),
            "smplh:left_hand_pose": turned[:, 25:40].astype(np.float32),
            "smplh:right_hand_pose": turned[:, 40:].astype(np.float32),
            "smplh:translation": np.linspace([0, 30, 200], [10, 30, 200], FRAMES).astype(np.float32),
            "smplh:is_valid": GOOD[:, 0].astype(bool),
            "movement:emotion_arousal": np.zeros((FRAMES, 1)),
        },
    )
    words = [{"word": "hands", "start": n + 0.1, "end": n + 0.6, "score": 0.9} for n in range(SECONDS)]
    segment = {"start": 0.1, "end": SECONDS - 0.4, "transcript": "hands " * SECONDS, "words": words}
    content = {"id": SEAMLESS, "metadata:transcript": [segment], "metadata:vad": [{"start": 0.1, "end": 11}]}
    (folder / f"{SEAMLESS}.json").write_text(json.dumps(content))
    return tmp_path / "seamless"


@pytest.fixture
def embody(poses, tmp_path):
    """A folder of Embody 3D with a capture of two people, of whom the second has no audio."""
    section = tmp_path / "datasets" / "acting"
    arrays = {
        "body_pose": poses[:, 1:22].reshape(FRAMES, -1),
        "global_orient": poses[:, 0],
        "left_hand_pose": poses[:, 25:40].reshape(FRAMES, -1),
        "right_hand_pose": poses[:, 40:].reshape(FRAMES, -1),
        "transl": np.linspace([0, 0, 0], [0.1, 0, 0], FRAMES),
        "betas": np.zeros((FRAMES, 300)),
    }
    for person in ("BWW760", "DXG448"):
        folder = section / CAPTURE / person
        for name, array in [*((f"smplx_mesh_{name}", array) for name, array in arrays.items()), ("missing", GOOD)]:
            (folder / name).mkdir(parents=True)
            np.save(folder / name / f"{CAPTURE}.npy", array)
    _sound(section / CAPTURE / "BWW760" / "separated_audio" / f"{CAPTURE}.wav")
    (section / "dataset.json").write_text("{}")
    return tmp_path / "datasets"


def _compare(corpus, expected):
    """Compare the clips before and after the second that was not tracked with the motion that was written."""
    clips = corpus.clips("train")
    assert [clip.recording_start for clip in clips] == [0, BAD.stop / 30]
    assert len(clips[0].positions) == BAD.start // 2 and clips[0].id.endswith("-0") and clips[1].id.endswith("-1")
    for clip in clips:
        start = round(15 * clip.recording_start)
        part = expected[start : start + len(clip.positions)]
        moved = clip.positions - clip.positions[:, :1]
        np.testing.assert_allclose(moved, part - part[:, :1], atol=5e-3)  # bones have their mean lengths


def test_seamless_interaction(seamless, expected, tmp_path):
    report = import_smplx(seamless, tmp_path / "out")["train"]
    corpus = Corpus.open(tmp_path / "out")
    assert (report.videos, report.clips) == (1, 2) and report.kept > 0
    assert corpus.speakers == ("P0947",) and corpus.metadata["motion"] == {"poses, -y up": 1}
    _compare(corpus, expected)
    first, second = corpus.clips("train")
    assert len(first.words) == 5 and first.words[0].start == pytest.approx(0.1)
    assert len(second.words) == 6 and second.words[0].start == pytest.approx(0.1)
    drift = np.ptp(second.positions[:, 0, 0])
    assert 0.03 < drift < 0.06  # centimetres became metres


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_frames_that_were_not_tracked_do_not_count(value, seamless, expected, tmp_path):
    """Neither the axes, which are means over time, nor the checks of values depend on them, however many they are."""
    (path,) = seamless.rglob("*.npz")
    arrays = dict(np.load(path))
    bad = np.arange(FRAMES) >= 0.4 * FRAMES
    for name, array in arrays.items():
        if name.startswith("smplh:") and name != "smplh:is_valid":
            array[bad] = value
    arrays["smplh:is_valid"] = ~bad
    np.savez(path, **arrays)
    import_smplx(seamless, tmp_path / "out")
    corpus = Corpus.open(tmp_path / "out")
    (clip,) = corpus.clips("train")
    assert corpus.metadata["motion"] == {"poses, -y up": 1}
    moved, part = clip.positions - clip.positions[:, :1], expected[: len(clip.positions)]
    np.testing.assert_allclose(moved, part - part[:, :1], atol=0.02)  # the heading is the mean over other frames


def test_embody_3d(embody, expected, tmp_path, caplog):
    report = import_smplx(embody, tmp_path / "out", ImportOptions(with_words=False))["train"]
    corpus = Corpus.open(tmp_path / "out")
    assert (report.videos, dict(report.rejected)) == (1, {"unusable recording": 1}) and report.kept > 0
    assert "has no audio" in caplog.text
    assert corpus.speakers == ("BWW760",) and corpus.clips("train")[0].recording == f"{CAPTURE}--BWW760"
    _compare(corpus, expected)


def test_motion_that_was_not_tracked_is_said(seamless, tmp_path, caplog):
    (path,) = seamless.rglob("*.npz")
    read_motion(path)
    assert re.search(rf"in 3[01] of {FRAMES} frames the person was not tracked", caplog.text)
    with np.load(path) as arrays:
        np.savez(tmp_path / "never.npz", **{**arrays, "smplh:is_valid": np.zeros(FRAMES, bool)})
    with pytest.raises(UserError, match="no frame in which the person was tracked"):
        read_motion(tmp_path / "never.npz")


def test_a_person_who_was_never_tracked_and_marks_of_another_length(embody, tmp_path):
    for marks, message in ((np.zeros(FRAMES), "no frame in which"), (np.ones(5), "marks of good frames have shape")):
        for path in embody.rglob("missing/*.npy"):
            np.save(path, marks)
        with pytest.raises(UserError, match=message):
            import_smplx(embody / "acting" / CAPTURE / "BWW760", tmp_path / "out", ImportOptions(with_words=False))
        assert not (tmp_path / "out").exists()
