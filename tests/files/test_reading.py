"""Exceptions of readers become one line that names the file; C libraries are silent while a thread asks for it."""

import concurrent.futures
import contextlib
import errno
import json
import os

import pytest

from ha2g_jax import cli
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import read_audio
from ha2g_jax.features.pictures import read_picture
from ha2g_jax.files.reading import files_below, parse_json, quiet, read_bytes, read_json, reading, shown
from ha2g_jax.files.tensors import open_tensors


def read_whole(path):
    return read_bytes(path, "a text", 100)


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ValueError("bad\nnumber"), r"x\.bvh is not a BVH file \(bad number\)"),
        (RecursionError("maximum depth"), "nested too deep"),
        (MemoryError(), r"x\.bvh needs more memory"),
        (OSError(errno.EIO, "Input/output error"), r"cannot read .*x\.bvh \(Input/output error\)"),
    ],
)
def test_exceptions_of_input_name_the_file(error, message):
    with pytest.raises(UserError, match=message) as caught, reading("x.bvh", "a BVH file"):
        raise error
    assert "\n" not in str(caught.value)
    assert caught.value.__cause__ is error


def test_other_exceptions_pass_unless_named():
    with pytest.raises(KeyError), reading("x.bvh", "a BVH file"):
        raise KeyError("x")
    with pytest.raises(UserError, match="not a BVH file"), reading("x.bvh", "a BVH file", KeyError):
        raise KeyError("x")
    with pytest.raises(UserError, match=r"^as it is$"), reading("x.bvh", "a BVH file"):
        raise UserError("as it is")


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 44\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.bvh", LFS, "is a pointer of Git LFS, not the file: run git lfs pull"),
        ("a.wav", b"/annex/objects/SHA256E-s44--4d7a.wav\n", "is a pointer of git-annex, .* run git annex get"),
        ("a.npz", b"\xef\xbb\xbf\n <!DOCTYPE HTML><title>Sign in</title>", "is a web page, not the file"),
        ("a.glb", b"<html lang=en>", "is a web page, not the file"),
        ("a.srt", b"", "is an empty file"),
        ("a.wav.crdownload", b"RIFF", "is an unfinished download"),
    ],
)
@pytest.mark.parametrize("read", [read_whole, read_picture, lambda path: open_tensors(path).__enter__(), read_audio])
def test_a_file_that_has_not_arrived_is_named(tmp_path, read, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=message):
        read(tmp_path / name)


def test_a_page_that_is_named_as_one_has_arrived(tmp_path):
    (tmp_path / "a.html").write_bytes(b"<html>")
    assert read_whole(tmp_path / "a.html") == b"<html>"


def test_a_pipe_keeps_its_content(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        done = pool.submit((tmp_path / "pipe").write_bytes, b"content")
        assert read_whole(tmp_path / "pipe") == b"content"
        done.result()


def test_any_path_is_shown():
    assert shown("sp\u00e9ech.wav") == "sp\u00e9ech.wav"
    assert shown(os.fsdecode(b"a\xff\n.wav")) == "a\\xff\\n.wav"
    assert len(shown("x" * 5000)) < 300


def test_linked_folders_are_read_once(tmp_path):
    """Protects data on another disk, which is linked into a folder, and from links in a circle."""
    (tmp_path / "disk" / "ada").mkdir(parents=True)
    (tmp_path / "disk" / "ada" / "talk.bvh").touch()
    (tmp_path / "data").mkdir()
    for name in ("linked", "twice"):
        (tmp_path / "data" / name).symlink_to(tmp_path / "disk")
    (tmp_path / "disk" / "circle").symlink_to(tmp_path / "data")
    assert list(files_below(tmp_path / "data")) == [tmp_path / "data" / "linked" / "ada" / "talk.bvh"]


def test_a_file_beyond_the_size_is_not_read(tmp_path):
    (tmp_path / "a").write_bytes(b"12345")
    assert read_bytes(tmp_path / "a", "a text", 5) == b"12345"
    with pytest.raises(UserError, match="more than 4 bytes"):
        read_bytes(tmp_path / "a", "a text", 4)
    with pytest.raises(UserError, match="No such file"):
        read_bytes(tmp_path / "b", "a text", 4)
    with pytest.raises(UserError, match="cannot read"):
        read_bytes(tmp_path / ("x" * 300), "a text", 4)


@pytest.mark.parametrize("text", ["[" * 200_000, "[" * 65 + "1" + "]" * 65, '{"a":' * 100_000])
def test_json_nested_deep_is_refused(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(UserError, match=r"a\.json is not a list of words \("):
        read_json(tmp_path / "a.json", "a list of words", 1 << 20)


def test_json_is_read_as_by_the_library(tmp_path):
    value = {"a": [1, 2.5, None, {"b": "\u00e9"}], "c": []}
    assert parse_json(json.dumps(value)) == value
    (tmp_path / "a.json").write_bytes(b"\xef\xbb\xbf" + json.dumps(value).encode())
    assert read_json(tmp_path / "a.json", "words", 1 << 20) == value


def test_contexts_that_overlap_restore_the_standard_error(capfd):
    before = os.fstat(2)
    first, second = contextlib.ExitStack(), contextlib.ExitStack()
    first.enter_context(quiet())
    second.enter_context(quiet())
    first.close()
    os.write(2, b"silent\n")
    second.close()
    os.write(2, b"heard\n")
    after = os.fstat(2)
    assert (after.st_dev, after.st_ino) == (before.st_dev, before.st_ino)
    assert capfd.readouterr().err == "heard\n"


@pytest.mark.parametrize(
    "command",
    [
        ["study", "make", "loop", "other", "-o", "study"],
        ["data", "merge", "loop", "other", "merged"],
        ["evaluate", "--motion", "loop", "--reference", "other"],
        ["data", "import", "loop", "corpus"],
        ["generate", "loop", "-o", "a.npz"],
        ["runs", "loop"],
        ["export", "loop", "-o", "a.bvh"],
    ],
)
def test_a_link_to_itself_is_said_in_a_line(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    for name, target in (("loop", "loop"), ("other", "back"), ("back", "other")):
        (tmp_path / name).symlink_to(target)
    with contextlib.suppress(SystemExit):
        assert cli.main(command) == 2
    error = capsys.readouterr().err
    assert ("loop" in error or "other" in error) and "Traceback" not in error and "an error of ha2g" not in error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["back", "loop", "other"]
