"""The cache folder is where the environment says, as the specification of XDG has it."""

import pathlib

import pytest

from ha2g_jax.files.cache_folder import cache_folder

HOME = pathlib.Path("/home/ada")


@pytest.mark.parametrize(
    ("own", "shared", "expected"),
    [
        ("/big/ha2g", "/caches", "/big/ha2g"),
        (None, "/caches", "/caches/ha2g-jax"),
        ("", "/caches", "/caches/ha2g-jax"),
        (None, "relative", "/home/ada/.cache/ha2g-jax"),
        (None, "", "/home/ada/.cache/ha2g-jax"),
        (None, None, "/home/ada/.cache/ha2g-jax"),
    ],
)
def test_the_first_that_is_set_wins(own, shared, expected, monkeypatch):
    monkeypatch.setenv("HOME", str(HOME))
    for name, value in (("HA2G_CACHE", own), ("XDG_CACHE_HOME", shared)):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    assert cache_folder() == pathlib.Path(expected)
