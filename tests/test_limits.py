"""docs/limits.md states the limits of the package, with their values."""

import pathlib
import re

from ha2g_jax import limits

PAGE = pathlib.Path(__file__).parent.parent / "docs" / "limits.md"


def test_the_page_states_every_limit():
    rows = re.findall(r"^\|.*\(`([A-Z_0-9]+)`\) \| ([\d,.]+)[^|]*\|$", PAGE.read_text(), re.MULTILINE)
    stated = {name: float(value.replace(",", "")) for name, value in rows}
    assert stated == {name: float(value) for name, value in vars(limits).items() if name.isupper()}
