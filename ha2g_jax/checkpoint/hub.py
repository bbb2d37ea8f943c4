"""Models on the Hugging Face Hub: fetched by name and revision, and published.

A name is hf://OWNER/NAME or hf://OWNER/NAME@REVISION, where the revision is a commit, a tag or a branch. Only the three
files of a model folder are fetched, into the cache of huggingface_hub, and none of them is executed: they are JSON and
safetensors, and are checked as those of any model folder, the weights against their hash. Without a connection the
files that were fetched before are used.
"""

import contextlib
import os
import pathlib
import re
import sys
from collections.abc import Iterator
from typing import Any

from tqdm import tqdm

from ha2g_jax.checkpoint import ASSETS, CONFIG, WEIGHTS
from ha2g_jax.errors import UserError, require
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.limits import MAX_ASSETS_BYTES, MAX_CONFIG_BYTES, MAX_WEIGHTS_BYTES

PREFIX = "hf://"
# The files of a model folder, and the maximum size of each in bytes.
FILES = {CONFIG: MAX_CONFIG_BYTES, ASSETS: MAX_ASSETS_BYTES, WEIGHTS: MAX_WEIGHTS_BYTES}

_PART = r"[A-Za-z0-9][A-Za-z0-9._-]{0,95}"
_NAME = re.compile(rf"({_PART}/{_PART})(?:@([A-Za-z0-9][A-Za-z0-9._/-]{{0,199}}))?")
_COMMIT = re.compile(r"[0-9a-f]{40}")


def is_hub_name(name: Any) -> bool:
    """Return whether the name of a model refers to the Hub, hf://OWNER/NAME."""
    return isinstance(name, str) and name.startswith(PREFIX)


def parse_name(name: str) -> tuple[str, str | None]:
    """Return OWNER/NAME and the revision, None for the main branch, of a name with or without the prefix hf://.

    Raises:
        UserError: the name has another form.
    """
    found = _NAME.fullmatch(name.removeprefix(PREFIX))
    if not found or ".." in name:
        expected = f"{PREFIX if is_hub_name(name) else ''}OWNER/NAME"
        raise UserError(
            f"'{shown(name)}' is not the name of a model on the Hub; expected {expected} or {expected}@REVISION"
        )
    return found[1], found[2]


def fetch(name: str) -> pathlib.Path:
    """Return the local folder of a model on the Hub, after fetching it to the cache if it is not there.

    If the revision is not a commit, a line on stderr names the commit, so that it can be pinned.

    Returns:
        A folder with the files of a model folder. What they contain has not been checked.

    Raises:
        UserError: the name has another form, the extra hub is not installed, there is no such model, a file is missing
            or too large, or there is neither a connection nor a copy in the cache.
    """
    repository, revision = parse_name(name)
    library = _library()
    options = {"revision": revision, "allow_patterns": list(FILES), "endpoint": _endpoint(), "tqdm_class": _Bar}
    with _blame(name):
        try:
            planned = library.snapshot_download(repository, dry_run=True, **options)
        except library.errors.DryRunError:  # the Hub cannot be reached, or does not give the model
            folder = pathlib.Path(library.snapshot_download(repository, local_files_only=True, **options))
        else:
            _check_files(name, {file.filename: file.file_size for file in planned})
            folder = pathlib.Path(library.snapshot_download(repository, **options))
    _check_files(name, {file: (folder / file).stat().st_size for file in FILES if (folder / file).is_file()})
    if revision is None or not _COMMIT.fullmatch(revision):
        tqdm.write(f"{shown(name)} is {PREFIX}{repository}@{folder.name}", file=sys.stderr)
    return folder


def publish(folder: pathlib.Path, card: str, name: str, *, is_private: bool, message: str) -> str:
    """Publish a model folder, with the text of its card, as one commit; create the repository if it does not exist.

    The name is OWNER/NAME or, of a branch that exists, OWNER/NAME@BRANCH; that of the published model, with its commit,
    is returned.

    Raises:
        UserError: the name has another form, the extra hub is not installed, the repository is public but should be
            private, the token of the user is missing or does not allow it, or the Hub cannot be reached.
    """
    repository, branch = parse_name(name)
    library = _library()
    api = library.HfApi(endpoint=_endpoint())
    contents = {file: folder / file for file in FILES} | {"README.md": card.encode()}
    operations = [library.CommitOperationAdd(path_in_repo=path, path_or_fileobj=it) for path, it in contents.items()]
    with _blame(name):
        if branch is None:
            api.create_repo(repository, private=is_private, exist_ok=True)
        if is_private and not api.repo_info(repository).private:
            raise UserError(f"{shown(name)} exists and is public; leave --private out, or choose another name")
        done = api.create_commit(repository, operations, commit_message=message, revision=branch)
    return f"{PREFIX}{repository}@{done.oid}"


class _Bar(tqdm):
    """Progress bar of a download, on a terminal only."""

    def __init__(self, *arguments: Any, **settings: Any):
        settings.pop("name", None)
        super().__init__(*arguments, **settings | {"disable": None, "leave": False})


def _library() -> Any:
    return require("huggingface_hub", "hub", by="a model of the Hub")


def _endpoint() -> str | None:
    return os.environ.get("HF_ENDPOINT") or None


def _check_files(name: str, sizes: dict[str, int | None]) -> None:
    """Check that each file of a model folder exists and is not too large."""
    for file, most in FILES.items():
        size = sizes.get(file, -1)
        if size == -1:
            raise UserError(f"{shown(name)} has no {file}; expected a model that ha2g model publish wrote")
        if size is None or size > most:
            raise UserError(f"{file} of {shown(name)} has {size} bytes; expected at most {most}")


@contextlib.contextmanager
def _blame(name: str) -> Iterator[None]:
    """Turn the exceptions of huggingface_hub into a `UserError` that names the model."""
    from huggingface_hub import errors

    try:
        yield
    except (errors.RepositoryNotFoundError, errors.LocalTokenNotFoundError) as error:
        raise UserError(
            f"no access to {shown(name)} on the Hub; check the name, or store a token with `hf auth login`"
        ) from error
    except errors.RevisionNotFoundError as error:
        raise UserError(f"{shown(name)} has no such revision; name a commit, a tag or a branch of it") from error
    except errors.LocalEntryNotFoundError as error:
        raise UserError(
            f"{shown(name)} is not in the cache, and the Hub cannot be reached or has no such model that this user may "
            "read; `hf auth login` stores a token"
        ) from error
    except (errors.HTTPError, OSError, ValueError) as error:
        raise UserError(f"{shown(name)} cannot be used ({reason(error)})") from error
