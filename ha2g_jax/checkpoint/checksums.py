"""Checksums of the files of a folder in SHA256SUMS, which `sha256sum -c` can read too."""

import hashlib
import pathlib

from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_RECORD_BYTES

CHECKSUMS = "SHA256SUMS"


def write(folder: pathlib.Path) -> None:
    """Write SHA256SUMS into a folder; it covers all files in subfolders, not files in the folder itself.

    Args:
        folder: folder of a checkpoint.
    """
    (folder / CHECKSUMS).write_text(_listing(_digests(folder)))


def damage(folder: pathlib.Path) -> str:
    """Describe in a few words which file of a folder was changed, removed or added; return "" if none was.

    Args:
        folder: folder of a checkpoint.

    Raises:
        OSError: a file cannot be read.
    """
    if not folder.is_dir():
        return "there is no such folder"
    if not (folder / CHECKSUMS).is_file():
        return f"{CHECKSUMS} is missing"
    with (folder / CHECKSUMS).open("rb") as file:
        text = file.read(MAX_RECORD_BYTES).decode(errors="replace")
    expected = {name: digest for digest, _, name in (line.partition("  ") for line in text.splitlines())}
    # Names come first: a file that does not belong may have any size.
    files = _files(folder)
    for name in sorted(expected.keys() | files.keys()):
        if name not in files:
            return f"{shown(name)} is missing"
        if name not in expected:
            return f"{shown(name)} does not belong"
    found = {}
    for name in sorted(files):
        found[name] = _digest(files[name])
        if found[name] != expected[name]:
            return f"{shown(name)} is not what was saved"
    return "" if text == _listing(found) else f"{CHECKSUMS} is not what was saved"


def _digests(folder: pathlib.Path) -> dict[str, str]:
    return {name: _digest(path) for name, path in _files(folder).items()}


def _files(folder: pathlib.Path) -> dict[str, pathlib.Path]:
    """Return the files in subfolders by their path below the folder."""
    return {
        path.relative_to(folder).as_posix(): path
        for path in folder.rglob("*")
        if path.is_file() and path.parent != folder
    }


def _digest(path: pathlib.Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _listing(digests: dict[str, str]) -> str:
    return "".join(f"{digest}  {name}\n" for name, digest in sorted(digests.items()))
