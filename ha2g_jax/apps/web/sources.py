"""Sources of the npm package ha2g-web: in this package where it is installed from a wheel, else beside it."""

import hashlib
import importlib.resources
import pathlib
import shutil

from ha2g_jax.errors import UserError

# What the site is built from; the tests of the npm package and what npm installs are left out.
PARTS = ("package.json", "package-lock.json", "tsconfig.json", "build.mjs", "LICENSE", "src", "site")
_ASSETS = ("skeletons", "rigs", "joint_limits.json")  # of this package


def find_sources() -> pathlib.Path:
    """Return the folder of the sources.

    Raises:
        UserError: there are no sources, neither packaged nor of a checkout.
    """
    package = _package()
    for folder in (package / "assets" / "web", package.parent / "integrations" / "web"):
        if (folder / "package-lock.json").is_file() and (folder / "site").is_dir():
            return folder
    raise UserError("the sources of ha2g-web are not installed; install ha2g-jax again, or use a checkout")


def find_example() -> pathlib.Path:
    """Return the recording that the page offers to try.

    Raises:
        UserError: it is neither packaged nor in a checkout.
    """
    for folder in (_package() / "assets" / "web", _package().parent / "examples"):
        if (folder / "hello.wav").is_file():
            return folder / "hello.wav"
    raise UserError("hello.wav is not installed; install ha2g-jax again, or use a checkout")


def hash_of(sources: pathlib.Path) -> str:
    """Return a hash of the names and the contents of the sources, 16 hexadecimal digits."""
    total = hashlib.sha256()
    for name, path in _files(sources).items():
        content = path.read_bytes()
        total.update(b"%d %d " % (len(name.encode()), len(content)) + name.encode() + content)
    return total.hexdigest()[:16]


def copy(sources: pathlib.Path, folder: pathlib.Path) -> pathlib.Path:
    """Copy the sources to a folder, which exists, with the files of this package that they import.

    Returns:
        The folder of package.json.

    Raises:
        OSError: a file cannot be read or written.
    """
    for name, path in _files(sources).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, folder / name)
    return folder / "integrations" / "web"


def _package() -> pathlib.Path:
    return pathlib.Path(str(importlib.resources.files("ha2g_jax")))


def _files(sources: pathlib.Path) -> dict[str, pathlib.Path]:
    """Return the files by their names in a checkout."""
    roots = {"integrations/web": (sources, PARTS), "ha2g_jax/assets": (_package() / "assets", _ASSETS)}
    found = {}
    for root, (folder, parts) in roots.items():
        for part in parts:
            paths = [folder / part] if (folder / part).is_file() else (folder / part).rglob("*")
            found |= {f"{root}/{path.relative_to(folder).as_posix()}": path for path in paths if path.is_file()}
    return {name: found[name] for name in sorted(found) if not name.rpartition("/")[2].startswith(".")}
