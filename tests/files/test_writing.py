"""Files are written atomically; a path that cannot be written is refused in one line."""

import errno
import os

import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.files.writing import check_kept, check_new, whole_file, whole_folder


def test_a_result_does_not_overwrite_what_is_read(tmp_path):
    read, link = tmp_path / "read.bvh", tmp_path / "link.bvh"
    link.symlink_to(read)
    check_kept([tmp_path / "new.bvh"], [read, None])
    for result in (read, link, tmp_path / "below" / ".." / "read.bvh"):
        with pytest.raises(UserError, match=r"the page would overwrite .*read\.bvh; choose another path with -o"):
            check_kept([tmp_path / "new.bvh", result], [None, read], what="page", option="-o")


@pytest.mark.parametrize("is_there", [True, False])
def test_the_target_of_a_link_is_written(is_there, tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "real.txt", tmp_path / "link.txt"
    if is_there:
        target.write_text("old")
    link.symlink_to(target)
    with whole_file(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink() and target.read_text() == "new"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["link.txt", "real.txt", "there"]


def test_a_pipe_stays_one(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    with (
        pytest.raises(UserError, match=r"cannot write .*pipe\.csv \(is a device or a pipe\)"),
        whole_file(tmp_path / "pipe.csv"),
    ):
        raise AssertionError
    assert (tmp_path / "pipe.csv").is_fifo()


def test_a_link_to_itself_is_replaced(tmp_path):
    loop = tmp_path / "loop.txt"
    loop.symlink_to(loop)
    check_kept([loop], [tmp_path / "read.txt", loop.with_name("other.txt")])
    with whole_file(loop) as temporary:
        temporary.write_text("new")
    assert loop.read_text() == "new" and not loop.is_symlink()


def test_the_longest_name_can_be_written(tmp_path):
    path = tmp_path / f"{'a' * 251}.txt"
    with whole_file(path) as temporary:
        temporary.write_text("new")
    assert [found.name for found in tmp_path.iterdir()] == [path.name]
    with pytest.raises(UserError, match="file name too long"), whole_file(tmp_path / f"{'a' * 252}.txt"):
        pytest.fail("it was taken")


def test_a_folder_is_there_when_it_is_complete(tmp_path):
    path = tmp_path / "above" / f"{'a' * 255}"
    with whole_folder(path) as folder:
        (folder / "file.txt").write_text("new")
        assert not path.exists()
    assert [found.name for found in tmp_path.rglob("*")] == ["above", path.name, "file.txt"]
    assert path.stat().st_mode & 0o777 == 0o755
    with pytest.raises(KeyboardInterrupt), whole_folder(tmp_path / "other" / "new") as folder:
        (folder / "file.txt").write_text("new")
        raise KeyboardInterrupt
    assert [found.name for found in tmp_path.iterdir()] == ["above"]


def test_a_folder_replaces_nothing_but_an_empty_one(tmp_path):
    (tmp_path / "empty").mkdir()
    with whole_folder(tmp_path / "empty") as folder:
        (folder / "file.txt").write_text("new")
    (tmp_path / "link").symlink_to("nowhere")
    for name in ("empty", "empty/file.txt", "link"):
        with pytest.raises(UserError, match="exists already; choose another folder or remove it"):
            check_new(tmp_path / name)
        with pytest.raises(UserError, match="exists already"), whole_folder(tmp_path / name):
            pytest.fail("the path was taken")
    with pytest.raises(UserError, match="exists already"), whole_folder(tmp_path / "raced") as folder:
        (tmp_path / "raced" / "first").mkdir(parents=True)
    assert sorted(found.name for found in tmp_path.iterdir()) == ["empty", "link", "raced"]


def test_a_full_disk_is_one_line(tmp_path):
    line = r"cannot write .*new \(no space left on device\); use another folder or free disk space"
    for write in (whole_file, whole_folder):
        with pytest.raises(UserError, match=line), write(tmp_path / "new"):
            raise OSError(errno.ENOSPC, "No space left on device")
    with (
        pytest.raises(UserError, match=line) as caught,
        whole_file(tmp_path / "new") as outer,
        whole_file(outer),
    ):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert isinstance(caught.value.__cause__, OSError)
    assert not list(tmp_path.iterdir())
