"""The TED data import by the published rule to the last window, and bad files end in one line and nothing else."""

import json
import math
import pathlib
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fixtures.ted_files import make_video, write_database
from scipy.interpolate import interp1d

from ha2g_jax.data import recording
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.importers.ted import arrow, clips, importer
from ha2g_jax.importers.ted.importer import import_ted
from ha2g_jax.skeleton import Skeleton, load_skeleton

SAMPLES = {"expressive": "ted_expressive", "gesture": "ted_gesture"}


@pytest.fixture(scope="module", params=SAMPLES)
def sample(request: pytest.FixtureRequest, private_data: pathlib.Path, tmp_path_factory) -> dict[str, Any]:
    """A genuine sample: its folder, what is expected of it, and what the import made."""
    name, out = request.param, tmp_path_factory.mktemp(request.param) / "corpus"
    folder = private_data / "ted_format" / name
    expected = json.loads((private_data / "ted_format" / "expected.json").read_text())
    prefix = "lmdb_" if name == "gesture" else ""
    return {
        "folders": {split: folder / (prefix + split) for split in ("train", "val", "test")},
        "expected": {split: expected[f"{name}/{prefix}{split}"] for split in ("train", "val", "test")},
        "skeleton": load_skeleton(SAMPLES[name]),
        "report": import_ted(folder, out, workers=2),
        "corpus": Corpus.open(out),
    }


def test_genuine_counts_are_exact(sample: dict[str, Any]):
    assert list(sample["report"]) == ["train", "val", "test"]
    for split, counts in sample["report"].items():
        expected = sample["expected"][split]
        assert {**counts.as_json(), "rejected": None} == {
            "videos": expected["n_videos"],
            "clips": expected["n_clips"],
            "windows": expected["n_windows_tried"],
            "kept": expected["n_samples"],
            "filtered": expected["filtered"],
            "rejected": None,
        }
    assert sample["report"]["train"].rejected == {"no window left": 4, "too short": 1}
    saved = sample["corpus"].metadata["import"]
    assert saved == {split: counts.as_json() for split, counts in sample["report"].items()}
    assert sample["corpus"].skeleton.name == sample["skeleton"].name


def raw_clips(sample: dict[str, Any], split: str) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """(video, the clip's fields, what is expected of it) of every clip."""
    folder, made = sample["folders"][split], []
    for video in sample["expected"][split]["videos"]:
        value = arrow.deserialize(importer.read_value(folder, video["key"].encode()), "a record")
        assert value["vid"] == video["vid"]
        assert len(value["clips"]) == len(video["clips"])
        made += [(video["vid"], *pair) for pair in zip(value["clips"], video["clips"], strict=True)]
    return made


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_genuine_clips_and_every_verdict(sample: dict[str, Any], split: str):
    for _, clip, expected in raw_clips(sample, split):
        start, end = expected["start_time"], expected["end_time"]
        assert (clip["start_time"], clip["end_time"]) == (start, end)
        is_list = expected["skeleton_layout"].startswith("list")
        assert isinstance(clip["skeletons_3d"], list if is_list else np.ndarray)
        positions = clips.resample(np.asarray(clip["skeletons_3d"]), end - start)
        assert len(positions) == expected["n_frames_at_15fps"]
        assert np.abs(positions).mean() == pytest.approx(expected["mean_abs_resampled_pose"], abs=6e-6)
        assert (clip["audio_raw"].astype(float) ** 2).sum() == pytest.approx(
            expected["sum_of_audio_raw_squares"], abs=6e-3
        )
        assert clip["audio_feat"].shape == tuple(expected["audio_feat_shape"])
        words = [Word(*word) for word in clip["words"]]
        assert (len(words), words[0].text, words[-1].text) == (
            expected["n_words"],
            expected["first_word"],
            expected["last_word"],
        )
        choice = recording.choose_windows(positions, words, sample["skeleton"], start_time=start)
        assert list(choice.verdicts) == expected["windows"]


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_genuine_records(sample: dict[str, Any], split: str):
    corpus, expected = sample["corpus"], raw_clips(sample, split)
    kept = [(vid, fields, facts) for vid, fields, facts in expected if "kept" in facts["windows"]]
    assert len(corpus.clips(split)) == len(kept)
    for clip, (vid, _, facts) in zip(corpus.clips(split), kept, strict=True):
        seconds = facts["end_time"] - facts["start_time"]
        assert (clip.speaker, clip.recording, clip.recording_start) == (vid, vid, facts["start_time"])
        assert clip.window_starts == tuple(
            10 * index for index, verdict in enumerate(facts["windows"]) if verdict == "kept"
        )
        assert len(clip.audio) == round(16000 * seconds)
        # 16-bit rounding, and up to a sample at the end.
        assert (clip.audio.astype(float) ** 2).sum() == pytest.approx(facts["sum_of_audio_raw_squares"], rel=1e-3)
        assert (clip.words[0].text, clip.words[-1].text) == (facts["first_word"], facts["last_word"])
        assert all(0 <= word.start <= word.end <= len(clip.audio) / 16000 for word in clip.words)
    ids = [clip.id for name in corpus.splits for clip in corpus.clips(name)]
    assert len(set(ids)) == len(ids)  # a video has clips in several splits


def independent_directions(clip: dict[str, Any], skeleton: Skeleton) -> np.ndarray:
    """Unit vectors child - parent at 15 frames a second, in float64."""
    poses = np.stack(clip["skeletons_3d"]).astype(np.float64)
    step = len(poses) / (15 * (clip["end_time"] - clip["start_time"]))
    line = interp1d(np.arange(len(poses)), poses, axis=0, fill_value="extrapolate")
    positions = line(np.arange(0, len(poses), step))
    directions = np.stack([positions[:, child] - positions[:, parent] for parent, child in skeleton.bones], axis=1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def check_directions(corpus: Corpus, split: str, clips: list[dict[str, Any]], skeleton: Skeleton) -> int:
    """Compares all windows with the independent computation; returns their number."""
    windows = Windows(corpus, split, corpus.vocabulary(), num_frames=34, num_reference_images=0)
    expected = {clip["start_time"]: independent_directions(clip, skeleton) for clip in clips}
    for index in range(len(windows)):
        clip_id, start = windows.name(index).split("@")
        clip = corpus.clips(split)[windows.clip_index(index)]
        assert clip.id == clip_id
        part = expected[clip.recording_start][int(start) : int(start) + 34]
        np.testing.assert_allclose(windows.directions(index), part, rtol=0, atol=1e-6)
        np.testing.assert_allclose(windows.example(index)["directions"], part, rtol=0, atol=1e-6)
    return len(windows)


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_genuine_directions_agree_to_1e_6(sample: dict[str, Any], split: str):
    fields = [clip for _, clip, _ in raw_clips(sample, split)]
    compared = check_directions(sample["corpus"], split, fields, sample["skeleton"])
    assert compared == sample["expected"][split]["n_samples"]


@pytest.fixture
def dataset(tmp_path: pathlib.Path) -> pathlib.Path:
    """A data set of ten joints made for the test; videos have clips in two splits."""
    for split, count in (("lmdb_train", 3), ("lmdb_val", 1)):
        folder = tmp_path / "dataset" / split
        folder.mkdir(parents=True)
        write_database(folder, [make_video(f"video{i}", count if i else 0, seed=i) for i in range(4)])
    return tmp_path / "dataset"


def tree(folder: pathlib.Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_made_data_set(dataset: pathlib.Path, tmp_path: pathlib.Path):
    report = import_ted(dataset, tmp_path / "one", workers=1)
    assert import_ted(dataset, tmp_path / "two", workers=2) == report
    assert tree(tmp_path / "one") == tree(tmp_path / "two")
    # 4 s are 60 frames: windows at 0 and 10.
    none = dict.fromkeys(recording.REASONS, 0)
    assert report["train"].as_json() == {"videos": 4, "clips": 9, "windows": 18, "kept": 18, "filtered": none}
    assert report["val"].as_json() == {"videos": 4, "clips": 3, "windows": 6, "kept": 6, "filtered": none}
    corpus = Corpus.open(tmp_path / "one")
    assert corpus.skeleton.name == "ted_gesture"
    assert corpus.metadata["files"]["train"]["videos"] == 4
    assert corpus.speakers == ("video1", "video2", "video3")
    clip = corpus.clips("train")[1]
    assert (clip.id, clip.words[0], len(clip.audio)) == ("video1-20.00", Word("word", 0.0, 0.25), 64000)
    videos = [make_video("video1", 3, seed=1)]
    assert check_directions(corpus, "train", videos[0]["clips"], load_skeleton("ted_gesture")) == 18


def test_one_database_has_the_split_that_is_named(dataset: pathlib.Path, tmp_path: pathlib.Path):
    report = import_ted(dataset / "lmdb_val", tmp_path / "out", split="test", workers=1)
    assert list(report) == ["test"]
    assert Corpus.open(tmp_path / "out").splits == ("test",)


def test_words_are_cut_to_the_clip(tmp_path: pathlib.Path):
    video = make_video("video")
    video["clips"][0]["words"] = [["out", 9.0, 9.9], ["in", 9.9, 10.1], ["at", 12.0, 12.0], ["end", 13.9, 14.2]]
    import_ted(write_database(tmp_path, [video]), tmp_path / "out", workers=1)
    [clip] = Corpus.open(tmp_path / "out").clips("train")
    assert [word.text for word in clip.words] == ["in", "at", "end"]
    np.testing.assert_allclose([word[1:] for word in clip.words], [(0, 0.1), (2, 2), (3.9, 4)], atol=1e-9)


DAMAGES = {
    "poses that are not finite": lambda clip: clip["skeletons_3d"].__setitem__(3, np.full((10, 3), np.nan, "f4")),
    r"not \(frames, joints, 3\)": lambda clip: clip.update(skeletons_3d="none"),
    "0.50 s of audio for 4.00 s": lambda clip: clip.update(audio_raw=np.zeros(8000, "f2")),
    "100 frames in 1e[+]09 s": lambda clip: clip.update(end_time=1e9 + 10.0),
    "no time as end_time": lambda clip: clip.update(end_time=math.nan),
}


def test_damaged_clips_are_named_and_left_out(tmp_path: pathlib.Path, capsys: pytest.CaptureFixture):
    videos = [make_video("good")]
    for damage in DAMAGES.values():
        videos.append(make_video("bad", 2))
        damage(videos[-1]["clips"][0])
    report = import_ted(write_database(tmp_path, videos), tmp_path / "out", workers=1)["train"]
    assert report.rejected == {"damaged": len(DAMAGES)}
    assert (report.clips, report.kept) == (1 + 2 * len(DAMAGES), 2 * (1 + len(DAMAGES)))
    lines = [line for line in capsys.readouterr().err.splitlines() if "left out" in line]
    assert len(lines) == len(DAMAGES)
    for index, (line, message) in enumerate(zip(lines, DAMAGES, strict=True), start=1):
        assert line.startswith(f"{tmp_path / 'data.mdb'}, record {index:010d}, clip 0: ")
        assert re.search(message, line)


def test_short_clips_are_counted(tmp_path: pathlib.Path):
    video = make_video("video", 3)
    for clip, frames in ((video["clips"][0], 0), (video["clips"][1], 68)):  # 68 frames at 25 fps: 41 at 15
        clip["skeletons_3d"] = list(clip["skeletons_3d"][:frames])
        clip["audio_raw"] = clip["audio_raw"][: 640 * frames]
        clip["end_time"] = clip["start_time"] + frames / 25
    report = import_ted(write_database(tmp_path, [video]), tmp_path / "out", workers=1)["train"]
    assert (report.clips, report.windows, report.rejected) == (3, 2, {"too short": 2})


def refused(src: pathlib.Path, tmp_path: pathlib.Path, message: str) -> None:
    """The import fails with that line, and nothing is left of it."""
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(UserError, match=message) as error:
        import_ted(src, tmp_path / "out", workers=2)
    assert "\n" not in str(error.value)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:8192] + b"\xff" * (len(data) - 8192), r"lmdb_val(/data\.mdb)?"),
        (lambda data: data.replace(b"skeletons_3d", b"\xff" * 12), r"data\.mdb, record 0000000001 is damaged"),
    ],
)
def test_damaged_databases_are_refused(
    dataset: pathlib.Path, tmp_path: pathlib.Path, change: Callable[[bytes], bytes], message: str
):
    path = dataset / "lmdb_val" / "data.mdb"
    path.write_bytes(change(path.read_bytes()))
    refused(dataset, tmp_path, message)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (b"not serialized by anything", r"record 0000000001 is damaged or not of pyarrow 0\.14"),
        ({"vid": "video", "frames": []}, "record 0000000001 is not a video of the TED data"),
    ],
)
def test_other_values_are_refused(tmp_path: pathlib.Path, value: Any, message: str):
    refused(write_database(tmp_path, [make_video("video"), value]), tmp_path, message)


def test_other_and_mixed_skeletons_are_refused(dataset: pathlib.Path, tmp_path: pathlib.Path):
    for name in ("mixed", "other"):
        (tmp_path / name).mkdir()
    refused(
        write_database(tmp_path / "mixed", [make_video("a"), make_video("b", joints=43)]),
        tmp_path,
        "record 0000000001, clip 0 has 43 joints, not the 10 of ted_gesture",
    )
    other = make_video("other")
    other["clips"][0]["skeletons_3d"] = [np.zeros((12, 3), np.float32)] * 100
    message = r"data\.mdb has poses of 12 joints; expected 10 \(TED-Gesture\) or 43 \(TED-Expressive\)"
    refused(write_database(tmp_path / "other", [other]), tmp_path, message)
    (dataset / "lmdb_test").mkdir()
    write_database(dataset / "lmdb_test", [make_video("c", joints=43)])
    refused(dataset, tmp_path, "different skeletons: 10 joints in .*lmdb_train/data.mdb and 43 joints in .*lmdb_test")


def test_nothing_left_is_an_error_with_the_reasons(tmp_path: pathlib.Path):
    video = make_video("video", 2)
    for clip in video["clips"]:
        clip["words"] = []
    src = tmp_path / "lmdb"
    src.mkdir()
    refused(write_database(src, [video]), tmp_path, "no usable window .2 clips, 4 windows, left out: too_few_words 4")
    refused(write_database(src, [make_video("video", 0)]), tmp_path, "no poses in .*data.mdb")
