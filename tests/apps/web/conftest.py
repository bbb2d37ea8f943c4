"""The site of the demo, built as `ha2g web` builds it."""

import pathlib

import pytest

from ha2g_jax.apps.web.site import write_site
from ha2g_jax.errors import UserError


@pytest.fixture(scope="session")
def site(tmp_path_factory) -> pathlib.Path:
    """The folder of a site, which tests must not change; it is skipped where npm cannot build it."""
    try:
        return write_site("demo", tmp_path_factory.mktemp("web") / "site")
    except UserError as error:
        if not any(part in str(error) for part in ("node", "npm is not installed", "registry")):
            raise
        pytest.skip(str(error))
