"""Many videos become one corpus, whatever happens on the way."""

import dataclasses
import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest
from fixtures.videos import make_recording, pose_command

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.importers.video import build
from ha2g_jax.importers.video.settings import VideoSettings

LOCALLY = """
from ha2g_jax.importers.video import build
from ha2g_jax.importers.video.settings import VideoSettings

if __name__ == "__main__":
    build.build_video(*{arguments}, settings=VideoSettings.from_json({settings}), workers=1, **{options})
"""

# Starting a cluster forks, which a process that other tests have used JAX in must not.
ON_A_CLUSTER = """
from ha2g_jax.importers.video import build
from ha2g_jax.importers.video.settings import VideoSettings
from ray.cluster_utils import Cluster

if __name__ == "__main__":
    cluster = Cluster(initialize_head=True, head_node_args={{"num_cpus": 1, "include_dashboard": False}})
    try:
        cluster.add_node(num_cpus=1)
        settings = VideoSettings.from_json({settings})
        build.build_video(*{arguments}, settings=settings, runner="ray", address=cluster.address, **{options})
    finally:
        cluster.shutdown()
"""


@pytest.fixture(scope="module")
def videos(tmp_path_factory):
    """Two videos of two speakers."""
    folder = tmp_path_factory.mktemp("videos")
    for name in ("ada/1.mp4", "ben/2.mkv"):
        make_recording(folder / name)
    return folder


@pytest.fixture
def settings(tmp_path):
    return lambda kind="wave": VideoSettings(pose_command=pose_command(tmp_path / "calls", kind))


OPTIONS = {"split": "val", "licence": "mine"}


@pytest.fixture(scope="module")
def built(videos, tmp_path_factory):
    """The folder of an undisturbed build, its report and the videos with the skeletons."""
    folder = tmp_path_factory.mktemp("expected")
    settings = VideoSettings(pose_command=pose_command(folder / "calls"))
    report = build.build_video(
        [videos], folder / "dst", settings=settings, workers=1, overlay=folder / "seen", **OPTIONS
    )
    return folder, report


@pytest.fixture(scope="module")
def expected(built):
    """The corpus of an undisturbed build."""
    return _contents(built[0] / "dst")


def test_videos_become_a_corpus(videos, built):
    folder, report = built
    corpus = Corpus.open(folder / "dst")
    assert corpus.splits == ("val",) and report["val"].videos == 2 and report["val"].kept > 0
    clips = corpus.clips("val")[:]
    assert [(clip.id, clip.recording, clip.speaker) for clip in clips] == [
        ("ada/1-0", "ada/1", "ada"),
        ("ben/2-0", "ben/2", "ben"),
    ]
    metadata = corpus.metadata
    assert metadata["import"] == {"val": report["val"].as_json()} and metadata["failed"] == []
    assert (metadata["licence"], metadata["name"]) == ("mine", videos.name)
    assert {name: metadata["video"][name] for name in ("frames", "frames_with_both_hands", "shots")} == {
        "frames": 120,
        "frames_with_both_hands": 90,
        "shots": 2,
    }
    assert metadata["video"]["settings"]["min_seconds"] == 5
    assert str(videos) not in (folder / "dst" / "dataset.json").read_text()
    assert sorted(path.name for path in folder.iterdir()) == ["calls", "dst", "seen"]  # no work folder
    drawn = {path.relative_to(folder / "seen").as_posix() for path in (folder / "seen").rglob("*.mp4")}
    assert drawn == {"ada/1.mp4", "ben/2.mp4"}


def test_a_killed_worker_loses_nothing(videos, settings, expected, tmp_path):
    """Protects a long build from one crash, such as of a process that the system ends for want of memory."""
    build.build_video([videos], tmp_path / "dst", settings=settings("kill"), workers=2, **OPTIONS)
    assert (tmp_path / "killed").exists() and _contents(tmp_path / "dst") == expected
    assert sorted(_calls(tmp_path)) == ["1", "2", "2"]


def test_failures_are_named_and_only_they_are_done_again(settings, tmp_path, capsys):
    folder = tmp_path / "videos"
    make_recording(folder / "good.mp4")
    make_recording(folder / "mute.mp4", with_sound=False)
    (folder / "text.mp4").write_text("no video\n" * 100)
    build.build_video([folder], tmp_path / "dst", settings=settings(), workers=2)
    bad = ["mute", "text"]
    corpus = Corpus.open(tmp_path / "dst")
    assert [failed["video"] for failed in corpus.metadata["failed"]] == bad and len(corpus.clips("train")) == 1
    assert all(str(tmp_path) not in failed["reason"] for failed in corpus.metadata["failed"])
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("ha2g: ")]
    assert all(sum(f"failed: {name}" in line for line in lines) == 1 for name in bad) and len(lines) == 3
    assert "2 of 3 videos failed (mute, text)" in lines[-1] and ".dst-work" in lines[-1]

    make_recording(folder / "mute.mp4")
    (folder / "text.mp4").unlink()
    (tmp_path / "calls").unlink()
    (tmp_path / "dst").rename(tmp_path / "old")
    build.build_video([folder], tmp_path / "dst", settings=settings(), workers=2)
    assert _calls(tmp_path) == ["mute"] and not (tmp_path / ".dst-work").exists()
    assert len(Corpus.open(tmp_path / "dst").clips("train")) == 2


def test_a_killed_build_goes_on_where_it_was(videos, settings, expected, tmp_path):
    """Protects days of work: after kill -9 the first video is not done anew, and the corpus is the same."""
    process = subprocess.Popen([sys.executable, _script(tmp_path, LOCALLY, videos, settings("wait"))])
    while not (tmp_path / "waiting").exists():
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (tmp_path / "dst").exists() and _calls(tmp_path) == ["1", "2"]
    (tmp_path / "calls").unlink()  # and the estimator does not wait twice
    build.build_video([videos], tmp_path / "dst", settings=settings("wait"), workers=1, **OPTIONS)
    assert _calls(tmp_path) == ["2"] and _contents(tmp_path / "dst") == expected


def test_other_settings_do_the_videos_anew(settings, tmp_path):
    """Protects a resumed build from results that were made otherwise."""
    make_recording(tmp_path / "videos" / "good.mp4")
    (tmp_path / "videos" / "bad.mp4").write_bytes(b"")
    for number, changes in enumerate([{}, {"max_seconds": 4.0}]):
        changed = dataclasses.replace(settings(), **changes)
        build.build_video([tmp_path / "videos"], tmp_path / f"dst{number}", settings=changed, workers=2)
        (tmp_path / f".dst{number}-work").rename(tmp_path / f".dst{number + 1}-work")
    assert _calls(tmp_path) == ["good", "good"] and _contents(tmp_path / "dst0") != _contents(tmp_path / "dst1")


def test_a_build_without_clips_says_why(videos, settings, tmp_path):
    with pytest.raises(UserError, match=r"no clip is left of 1 video .1 shot or clip: still"):
        build.build_video([videos / "ada"], tmp_path / "dst", settings=settings("still"))
    assert [path.name for path in tmp_path.iterdir()] == ["calls"]


def test_if_all_fail_nothing_is_left(settings, tmp_path):
    (tmp_path / "bad.mp4").write_text("no video")
    with pytest.raises(UserError, match=r"^bad\.mp4"):
        build.build_video([tmp_path / "bad.mp4"], tmp_path / "dst", settings=settings())
    assert [path.name for path in tmp_path.iterdir()] == ["bad.mp4"]


def test_an_overlay_does_not_overwrite_its_video(settings, tmp_path):
    video = tmp_path / "talk.mp4"
    video.write_bytes(b"video")
    with pytest.raises(UserError, match=r"the overlay would overwrite .*talk\.mp4"):
        build.build_video([video], tmp_path / "new", settings=settings(), overlay=tmp_path)
    assert video.read_bytes() == b"video" and not (tmp_path / "calls").exists()


def test_what_is_not_installed_is_told_before_any_work(videos, settings, tmp_path, monkeypatch):
    monkeypatch.setattr(build.runners, "local", lambda *_: pytest.fail("the work began"))
    monkeypatch.setenv("HA2G_CACHE", str(tmp_path / "empty"))
    monkeypatch.delenv("HA2G_POSE_PYTHON", raising=False)
    with pytest.raises(UserError, match="run `ha2g data build-video --install`"):
        build.build_video([videos], tmp_path / "new", settings=dataclasses.replace(settings(), pose_command=None))
    monkeypatch.setitem(sys.modules, "scenedetect", None)
    with pytest.raises(UserError, match=r"needs scenedetect-headless: pip install 'ha2g-jax\[import\]'"):
        build.build_video([videos], tmp_path / "new", settings=settings())


def test_names_are_unique_and_speakers_are_folders(tmp_path):
    for name in (
        "b/x.mp4",
        "b/x.mov",
        "a/deep/x.MP4",
        "y.webm",
        ".hidden/z.mp4",
        "b/._x.mp4",
        "drawn/x.mp4",
        "b/x.txt",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("any content")
    root, found = build.find_recordings([tmp_path, tmp_path / "y.webm"], without=tmp_path / "drawn")
    assert root == tmp_path
    assert [(video.name, video.speaker) for video in found] == [
        ("a/deep/x", "a"),
        ("b/x.mov", "b"),
        ("b/x.mp4", "b"),
        ("y", "y"),
    ]
    (tmp_path / "b" / "x.txt").rename(tmp_path / "b" / "words.txt")
    (tmp_path / "a" / "deep" / "words.txt").touch()
    transcripts = [video.transcript and video.transcript.parent.name for video in found]
    assert transcripts == ["deep", None, None, None]  # whose words those of two videos are is not known
    _, found = build.find_recordings([tmp_path / "b" / "x.mp4"])
    assert [(video.name, video.speaker, video.transcript) for video in found] == [("x", "x", None)]
    _, found = build.find_recordings([tmp_path / "a", tmp_path / "y.webm"])
    assert [(video.name, video.speaker) for video in found] == [("a/deep/x", "a"), ("y", "y")]


def test_the_name_of_the_split_is_checked_before_a_video_is_read(videos, settings, tmp_path, monkeypatch):
    monkeypatch.setattr(build.runners, "local", lambda *_: pytest.fail("read"))
    with pytest.raises(UserError, match="cannot be the name of a split"):
        build.build_video([videos], tmp_path / "new", settings=settings(), split="my data")


def test_two_videos_with_one_shortened_name_are_refused(tmp_path):
    for number in range(2):
        folder = tmp_path / ("a" * 110 + f" {number} " + "b" * 90)
        folder.mkdir()
        (folder / ("c" * 90 + ".mp4")).touch()
    with pytest.raises(UserError, match="two videos would both be called a"):
        build.find_recordings([tmp_path])


def test_a_cluster_gives_the_same_bytes_and_survives_a_killed_worker(videos, settings, expected, tmp_path):
    """Two nodes of Ray, and the Ray worker of one video killed midway."""
    pytest.importorskip("ray")
    # The estimator kills the Ray worker above the process that called it.
    environment = {**os.environ, "RAY_USAGE_STATS_ENABLED": "0", "ABOVE": "1"}
    script = _script(tmp_path, ON_A_CLUSTER, videos, settings("kill"))
    subprocess.run([sys.executable, script], env=environment, check=True)
    assert (tmp_path / "killed").exists() and _contents(tmp_path / "dst") == expected
    assert sorted(_calls(tmp_path)) == ["1", "2", "2"]


def _contents(folder: pathlib.Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def _calls(folder: pathlib.Path) -> list[str]:
    return (folder / "calls").read_text().split()


def _script(folder: pathlib.Path, text: str, videos: pathlib.Path, settings: VideoSettings) -> pathlib.Path:
    arguments = [[str(videos)], str(folder / "dst")]
    path = folder / "script.py"
    path.write_text(text.format(arguments=arguments, settings=settings.as_json(), options=OPTIONS))
    return path
