"""A package that is missing is named in one line, with the extra that installs it."""

import pytest

from ha2g_jax.errors import UserError, require


def test_a_package_that_is_missing_is_named_with_its_extra(monkeypatch, tmp_path):
    with pytest.raises(UserError, match=r"^this needs no-such: pip install 'ha2g-jax\[live\]'$"):
        require("no_such.part", "live")
    (tmp_path / "broken.py").write_text("raise OSError('no\\nlibrary')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UserError, match=r"^sound needs Port, .* does not load \(no library\): apt install libport$"):
        require("broken", "live", by="sound", package="Port", library="apt install libport")
