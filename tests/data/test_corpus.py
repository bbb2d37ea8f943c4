"""A corpus is whole or not there, whatever happens; its statistics are those of training."""

import dataclasses
import pathlib
import pickle
import re
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from fixtures.corpora import edit, make_clip, write_corpus

from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.data.regroup import divide
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary, Word

SKELETON = "ted_gesture"


def clip_of(name: str, speaker: str, word: str, seed: int) -> Clip:
    """A clip of 5 frames and more, of random positions."""
    positions = np.random.default_rng(seed).normal(size=(5 + seed, 10, 3)).astype(np.float32)
    return make_clip(name, speaker=speaker, words=(Word(word, 0.0, 0.2),), positions=positions, window_starts=(0,))


CLIPS = {
    "train": [clip_of("a", "bo", "one", 0), clip_of("b", "al", "two", 1), clip_of("c", "bo", "two", 2)],
    "test": [clip_of("d", "cy", "three", 3), clip_of("e", "al", "four", 4)],
}


@pytest.fixture
def path(tmp_path):
    return write_corpus(tmp_path / "corpus", CLIPS)


def test_reads_what_was_written(path):
    corpus = Corpus.open(path)
    assert corpus.splits == ("train", "test")
    assert corpus.speakers == ("bo", "al", "cy")
    assert corpus.speakers_of("test") == ("cy", "al")
    assert corpus.vocabulary().words == ("two", "one")
    clips = pickle.loads(pickle.dumps(corpus.clips("train")))
    assert [clip.id for clip in clips] == ["a", "b", "c"]
    assert clips[-1].id == "c"
    np.testing.assert_array_equal(clips[1].positions, CLIPS["train"][1].positions)
    with pytest.raises(IndexError):
        clips[3]


def test_statistics_of_the_training_split(path):
    """All frames of all training clips at once give the same numbers as the running sums."""
    skeleton = Corpus.open(path).skeleton
    directions = [skeletons.positions_to_directions(skeleton, clip.positions) for clip in CLIPS["train"]]
    angles = [skeletons.joint_angles(skeleton, d) / np.pi for d in directions]
    changes = np.concatenate([np.abs(np.diff(a, axis=0)) for a in angles])
    np.testing.assert_allclose(skeleton.mean_directions, np.concatenate(directions).mean(0), atol=1e-6)
    np.testing.assert_allclose(skeleton.angle_mean, np.concatenate(angles).mean(0), atol=1e-6)
    np.testing.assert_allclose(skeleton.angle_variance, np.concatenate(angles).var(0), atol=1e-6)
    np.testing.assert_allclose(skeleton.angle_change, changes.mean(0), atol=1e-6)
    poses = np.concatenate([clip.positions - clip.positions[:, :1] for clip in CLIPS["train"]])
    np.testing.assert_allclose(skeleton.mean_pose, poses.mean(0), atol=1e-6)


def test_a_place_that_cannot_be_written(tmp_path):
    """One line about the corpus that was wanted, and no part of it."""
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("nowhere")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(UserError, match=r"cannot write .*file/corpus"):
        write_corpus(tmp_path / "file" / "corpus", CLIPS)
    with pytest.raises(UserError, match="link exists already"):
        write_corpus(tmp_path / "link", CLIPS)
    assert sorted(tmp_path.iterdir()) == before


def test_failure_leaves_nothing(tmp_path):
    with (
        pytest.raises(RuntimeError, match="stop"),
        CorpusWriter(tmp_path / "corpus", splits=("train",), skeleton=SKELETON, fps=15, metadata={}) as writer,
    ):
        writer.add("train", encode_clip(CLIPS["train"][0]))
        raise RuntimeError("stop")
    with pytest.raises(UserError, match="no clip to write"):
        write_corpus(tmp_path / "corpus", {"train": [], "test": []})
    assert list(tmp_path.iterdir()) == []


def test_a_split_may_be_empty(tmp_path):
    """An empty training split leaves the published statistics, and no vocabulary."""
    write_corpus(tmp_path / "corpus", {"train": [], "test": CLIPS["test"]})
    corpus = Corpus.open(tmp_path / "corpus")
    assert (len(corpus.clips("train")), len(corpus.clips("test"))) == (0, 2)
    assert corpus.speakers == ("cy", "al")
    assert corpus.vocabulary().words == ()
    np.testing.assert_array_equal(corpus.skeleton.angle_mean, skeletons.load_skeleton(SKELETON).angle_mean)


def test_statistics_are_of_what_training_sees(tmp_path):
    """Frames outside every window, such as those that a filter refused, do not count."""
    clip = clip_of("a", "bo", "one", 100)
    seen = dataclasses.replace(clip, positions=clip.positions[40:84], window_starts=(0, 10))
    windowed = dataclasses.replace(clip, window_starts=(40, 50))
    for name, made in (("seen", seen), ("windowed", windowed)):
        write_corpus(tmp_path / name, {"train": [made]})
    first, second = (Corpus.open(tmp_path / name).metadata["statistics"] for name in ("seen", "windowed"))
    assert first == second


def test_vocabulary_is_ordered_by_counts(path):
    running = ["b", "c", "a", "c"]
    edit(path, lambda data: data.update(words={word: running.count(word) for word in running}))
    assert Corpus.open(path).vocabulary() == Vocabulary(("c", "a", "b"))


@pytest.mark.parametrize("key", ["splits", "statistics", "fps", "speakers", "skeleton", "words"])
@pytest.mark.parametrize("value", [None, 3.5])
def test_a_description_that_is_damaged_is_one_line(path, key, value):
    values = {key: value} if value and key != "fps" else {key: "fast"}
    edit(path, lambda data: data.update(values) if value else data.pop(key))
    with pytest.raises(UserError, match=r"^.*dataset\.json.*$"):
        Corpus.open(path)


def test_damaged_shard(path):
    """A shortened shard is refused at once, one with other bytes when its clip is read."""
    shard = path / "test-00000.array_record"
    data = shard.read_bytes()
    shard.write_bytes(data[:-1000])
    with pytest.raises(UserError, match="bytes instead of"):
        Corpus.open(path)
    for damaged in (data[:300] + bytes(50) + data[350:], bytes(len(data))):
        shard.write_bytes(damaged)
        with pytest.raises(UserError, match=r"^.*test-00000\.array_record cannot be read .*$"):
            list(Corpus.open(path).clips("test"))
    shard.unlink()
    with pytest.raises(UserError, match="0 bytes instead of"):
        Corpus.open(path)


def test_a_clip_is_found_in_its_shard(tmp_path, monkeypatch):
    """Messages name the shard and the number in it; a shard that is damaged names itself."""
    monkeypatch.setattr("ha2g_jax.data.corpus_writer._CLIPS_PER_SHARD", 2)
    write_corpus(tmp_path / "corpus", CLIPS)
    clips = Corpus.open(tmp_path / "corpus").clips("train")
    found = [re.sub(r" of .*/", " of ", clips.place(index)) for index in range(3)]
    first, second = (f"train-0000{number}.array_record" for number in range(2))
    assert found == [f"record 0 of {first}", f"record 1 of {first}", f"record 0 of {second}"]
    assert [clips.fields(index)["id"] for index in range(3)] == ["a", "b", "c"]
    shard = tmp_path / "corpus" / "train-00001.array_record"
    shard.write_bytes(b"\x07" * shard.stat().st_size)
    with pytest.raises(UserError, match=r"train-00001\.array_record cannot be read"):
        Corpus.open(tmp_path / "corpus").clips("train")


# The process kills itself at the n-th call of one of the functions that write.
_CHILD = """
    import os, pathlib, resource, shutil, signal, sys
    import filelock
    from array_record.python import array_record_module
    from ha2g_jax import cli

    def deadly(function, n):
        calls = [0]
        def call(*args, **kwargs):
            calls[0] += 1
            if calls[0] == n:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*args, **kwargs)
        return call

    point, src, dst = sys.argv[1:]
    places = {
        "second shard": (array_record_module, "ArrayRecordWriter", 2),
        "before the rename": (pathlib.Path, "rename", 1),
        "after the rename": (shutil, "rmtree", 1),
    }
    if point == "full disk":
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
    elif point == "after the lock":
        acquire = filelock.FileLock.acquire
        def locked(self, *args, **kwargs):
            result = acquire(self, *args, **kwargs)
            os.kill(os.getpid(), signal.SIGKILL)
            return result
        filelock.FileLock.acquire = locked
    else:
        owner, name, n = places[point]
        setattr(owner, name, deadly(getattr(owner, name), n))
    sys.exit(cli.main(["data", "split", src, dst, "--fractions", "0.5", "0.5", "0"]))
"""


def _divide(point: str, src: pathlib.Path, dst: pathlib.Path) -> subprocess.CompletedProcess:
    argv = [sys.executable, "-c", textwrap.dedent(_CHILD), point, str(src), str(dst)]
    return subprocess.run(argv, capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize("point", ["after the lock", "second shard", "before the rename", "after the rename"])
def test_a_killed_process_leaves_a_whole_corpus_or_none(tiny_talk, tmp_path, point):
    """The next process removes what the dead one has left, but nothing of others."""
    dst = tmp_path / "new"
    (tmp_path / ".new-work").mkdir()
    assert _divide(point, tiny_talk, dst).returncode == -signal.SIGKILL
    assert any(path.name.endswith(".lock") for path in tmp_path.iterdir())
    if point == "after the rename":
        assert len(Corpus.open(dst).clips("train"))
        return
    with pytest.raises(UserError, match="no corpus in"):
        Corpus.open(dst)
    divide(tiny_talk, dst, fractions={"train": 1, "val": 1})
    assert sorted(path.name for path in tmp_path.iterdir()) == [".new-work", "new"]
    assert Corpus.open(dst).has_clips("train")


def test_a_full_disk(tiny_talk, tmp_path):
    done = _divide("full disk", tiny_talk, tmp_path / "new")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "cannot write" in done.stderr
    assert list(tmp_path.iterdir()) == []
