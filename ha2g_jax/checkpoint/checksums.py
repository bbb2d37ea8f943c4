"""Finds out whether the files of a folder are those that were written: SHA256SUMS, as `sha256sum -c` reads it."""

import hashlib
import pathlib

CHECKSUMS = "SHA256SUMS"


def write(folder: pathlib.Path) -> None:
    """Adds SHA256SUMS to a folder, which covers all files in the folders of `folder`, not those beside them."""
    (folder / CHECKSUMS).write_text(_listing(_digests(folder)))


def damage(folder: pathlib.Path) -> str:
    """What is wrong with a folder in a few words, "" where nothing is: files are changed, missing or added.

    Raises:
        OSError: a file cannot be read.
    """
    if not folder.is_dir():
        return "it is not there"
    if not (folder / CHECKSUMS).is_file():
        return f"{CHECKSUMS} is missing"
    text, found = (folder / CHECKSUMS).read_bytes().decode(errors="replace"), _digests(folder)
    expected = {name: digest for digest, _, name in (line.partition("  ") for line in text.splitlines())}
    for name in sorted(expected.keys() | found.keys()):
        if name not in found:
            return f"{name} is missing"
        if name not in expected:
            return f"{name} does not belong"
        if found[name] != expected[name]:
            return f"{name} is not what was saved"
    return "" if text == _listing(found) else f"{CHECKSUMS} is not what was saved"


def _digests(folder: pathlib.Path) -> dict[str, str]:
    digests = {}
    for path in folder.rglob("*"):
        if path.is_file() and path.parent != folder:
            with path.open("rb") as file:
                digests[path.relative_to(folder).as_posix()] = hashlib.file_digest(file, "sha256").hexdigest()
    return digests


def _listing(digests: dict[str, str]) -> str:
    return "".join(f"{digest}  {name}\n" for name, digest in sorted(digests.items()))
