"""The scripts of the site, which npm builds once from the sources of ha2g-web."""

import os
import pathlib
import re
import shutil
import subprocess
from collections.abc import Sequence

from ha2g_jax.apps.web import sources
from ha2g_jax.errors import UserError
from ha2g_jax.files.cache import cache_folder, one_maker
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import temporary_folder, writing
from ha2g_jax.progress import stage

_OLDEST_NODE = 20
_RESULT = pathlib.Path("build") / "site"
_UNREACHABLE = (
    "ENOTFOUND",
    "EAI_AGAIN",
    "ECONNREFUSED",
    "ECONNRESET",
    "ETIMEDOUT",
    "ENETUNREACH",
    "ERR_SOCKET_TIMEOUT",
)
_SECONDS = 900  # of one run of npm


def build_scripts() -> pathlib.Path:
    """Return the folder of the built files, in the cache folder; they are built unless these sources were before.

    Raises:
        UserError: node or npm is missing or too old, npm cannot reach its registry, or the build fails.
    """
    found = sources.find_sources()
    folder = cache_folder() / "web" / sources.hash_of(found)
    if folder.is_dir():
        return folder
    npm = _find_npm()
    with one_maker(folder):
        if folder.is_dir():  # another process has built it meanwhile
            return folder
        with writing(folder, "set HA2G_CACHE to another folder"), temporary_folder(folder) as temporary:
            project = sources.copy(found, temporary)
            with stage("installing what ha2g-web is built with"):
                _run([npm, "ci", "--no-audit", "--no-fund", "--ignore-scripts", "--loglevel=error"], project)
            with stage("building the site"):
                _run([npm, "run", "--silent", "build:site"], project)
            (project / _RESULT).rename(folder)
    return folder


def _find_npm() -> str:
    """Return the path of npm, after a look at the version of node."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if not node or not npm:
        missing = "node" if not node else "npm"
        raise UserError(f"{missing} is not installed; install Node.js {_OLDEST_NODE} or newer, which has npm")
    answer = subprocess.run([node, "--version"], capture_output=True, text=True, check=False).stdout.strip()
    version = re.match(r"v(\d+)\.", answer)
    if not version or int(version[1]) < _OLDEST_NODE:
        raise UserError(f"node is {shown(answer) or 'of an unknown version'}; install {_OLDEST_NODE} or newer")
    return npm


def _run(command: Sequence[str], folder: pathlib.Path) -> None:
    """Run npm in a folder; its output is shown where it fails, the line that says most."""
    environment = os.environ | {"npm_config_update_notifier": "false", "NO_COLOR": "1", "NODE_ENV": ""}
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise UserError(f"npm {command[1]} took more than {_SECONDS // 60} minutes; try again") from error
    if done.returncode == 0:
        return
    if any(code in done.stdout for code in _UNREACHABLE):
        raise UserError("npm cannot reach its registry; connect to the network, or set the registry with npm config")
    lines = [line.strip() for line in done.stdout.splitlines() if line.strip()]
    told = next((line for line in lines if re.search(r"\berror\b", line, re.IGNORECASE)), lines[-1] if lines else "")
    raise UserError(f"npm {command[1]} failed ({shown(told) or 'no output'}); run it in a checkout, in web/")
