"""A corpus is whole or not there, whenever its process is killed and whatever the disk says."""

import pathlib
import signal
import subprocess
import sys
import textwrap

import pytest

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError

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
            result = function(*args, **kwargs)
            if calls[0] == -n:
                os.kill(os.getpid(), signal.SIGKILL)
            return result
        return call

    point, src, dst = sys.argv[1:]
    owner, name, n = {
        "after the lock": (pathlib.Path, "mkdir", 1),
        "first clip": (array_record_module, "ArrayRecordWriter", 1),
        "second shard": (array_record_module, "ArrayRecordWriter", 2),
        "dataset.json": (pathlib.Path, "write_text", 1),
        "before the rename": (pathlib.Path, "rename", 1),
        "after the rename": (shutil, "rmtree", 1),
        "full disk": (resource, "getrlimit", 0),
    }[point]
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
    from ha2g_jax.data.regroup import divide

    divide(tiny_talk, dst, fractions={"train": 1, "val": 1})
    assert sorted(path.name for path in tmp_path.iterdir()) == [".new-work", "new"]
    assert Corpus.open(dst).has_clips("train")


def test_a_full_disk(tiny_talk, tmp_path):
    done = _divide("full disk", tiny_talk, tmp_path / "new")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "cannot write" in done.stderr
    assert list(tmp_path.iterdir()) == []
