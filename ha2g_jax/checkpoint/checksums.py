"""Checksums of the files of a folder in SHA256SUMS, which `sha256sum -c` can read too."""

import hashlib
import pathlib

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
