"""The data commands as they are typed: reports on stdout, one line and exit code 2 for files that cannot be used."""

import io
import json
import pathlib
import zipfile

import numpy as np
import pytest

from ha2g_jax import cli


def run(*arguments: object) -> int:
    return cli.main(["data", *map(str, arguments)])


def zip_bomb() -> bytes:
    """An npz of 100 kB that unpacks to 100 MB of zeros, and says that it is 4 TB."""
    header = b"\x93NUMPY\x01\x00v\x00{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000, 1000), }"
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as file, file.open("poses.npy", "w") as entry:
        entry.write(header.ljust(127) + b"\n")
        for _ in range(100):
            entry.write(bytes(1_000_000))
    return content.getvalue()


def pickled() -> bytes:
    """An npz whose poses are Python objects."""
    content = io.BytesIO()
    np.savez(content, poses=np.array([{"a": 1}], object))
    return content.getvalue()


CYCLE = (
    "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n"
    + "JOINT a\n{\nOFFSET 0 1 0\nCHANNELS 3 Zrotation Yrotation Xrotation\n" * 5000
)
HOSTILE = {
    "endless header": ("import-bvh", "a.bvh", CYCLE.encode()),
    "zip bomb": ("import-smplx", "a.npz", zip_bomb()),
    "pickled objects": ("import-smplx", "a.npz", pickled()),
    "garbage as LMDB": ("import-ted", "train/data.mdb", bytes(range(256)) * 64),
}


@pytest.mark.parametrize(("command", "name", "content"), HOSTILE.values(), ids=HOSTILE)
def test_a_file_that_cannot_be_used(command, name, content, tmp_path, capfd):
    """One line that names the file, and nothing that looks like a corpus."""
    src = tmp_path / "src"
    path = src / name
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    assert run(command, src, tmp_path / "corpus") == 2
    printed = capfd.readouterr()
    errors = [line for line in printed.err.splitlines() if line.startswith("ha2g: ")]
    assert len(errors) == 1
    assert path.name in printed.err
    assert "Traceback" not in printed.err and not printed.out
    assert not (tmp_path / "corpus").exists()


@pytest.mark.parametrize("command", ["import-ted", "build-video"])
def test_nothing_to_import(command, tmp_path, capsys):
    for src in (tmp_path / "nowhere", tmp_path):
        assert run(command, src, tmp_path / "corpus") == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and str(src) in error
    assert not list(tmp_path.iterdir())


def test_ted_files(private_data, tmp_path, capsys):
    """The report is what the files hold, split by split; the corpus can be validated, summarised and divided."""
    assert run("import-ted", private_data / "ted_format" / "gesture", tmp_path / "ted", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["train"]["filtered"] == {"too_few_words": 5, "pose": 5, "spine angle": 7, "motion": 5}
    assert [report[split]["kept"] for split in ("train", "val", "test")] == [40, 4, 6]
    assert run("validate", tmp_path / "ted") == 0
    assert run("stats", tmp_path / "ted", "--json") == 0
    capsys.readouterr()
    assert run("split", tmp_path / "ted", tmp_path / "divided", "--by", "speaker", "--fractions", 0.5, 0.25, 0.25) == 0
    assert pathlib.Path(capsys.readouterr().out.strip()) == tmp_path / "divided"


def test_the_folder_that_one_is_in_is_inspected(private_data, tmp_path, capsys, monkeypatch):
    """Its numbers are printed and its page is written, as those of any other folder."""
    assert run("import-ted", private_data / "ted_format" / "gesture" / "lmdb_test", tmp_path / "ted") == 0
    monkeypatch.chdir(tmp_path / "ted")
    assert run("inspect", ".") == 0 and "hours" in capsys.readouterr().out
    assert run("inspect", ".", "--samples", "0", "-o", "../ted.html") == 0
    assert (tmp_path / "ted.html").exists()
