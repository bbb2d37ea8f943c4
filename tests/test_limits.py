"""docs/limits.md states the limits of the package, with their values."""

import pathlib
import re

from ha2g_jax import limits

PAGE = pathlib.Path(__file__).parent.parent / "docs" / "limits.md"


def test_the_page_states_every_limit():
    rows = re.findall(r"^\|.*\(`([A-Z_0-9]+)`\) \| ([\d,.]+)[^|]*\|$", PAGE.read_text(), re.MULTILINE)
    stated = {name: float(value.replace(",", "")) for name, value in rows}
    assert stated == {name: float(value) for name, value in vars(limits).items() if name.isupper()}


def test_every_limit_has_a_name_of_its_own():
    names = re.findall(r"^([A-Z_0-9]+) = ", pathlib.Path(limits.__file__).read_text(), re.MULTILINE)
    assert len(names) == len(set(names))
