"""docs/model.md leads from each equation, table and decision to code; what tour and architecture name exists too."""

import importlib.util
import pathlib
import pkgutil
import re

import pytest

ROOT = pathlib.Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "model.md").read_text()
PAGES = {"model": PAGE, "tour": (ROOT / "docs" / "tour.md").read_text()}
# A link to a file, and the symbols after it.
ANCHOR = re.compile(r"\[`([^`]+)`\]\(([^)]+)\)((?:,?\s(?:and\s)?`[A-Za-z_][\w.]*`)+)")
SECTIONS = dict(re.findall(r"^### ([^\n]+)\n(.*?)(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL))


def anchors(text):
    """Return (file, symbol) of each place in the code that a text names."""
    return [(file, symbol) for file, _, names in ANCHOR.findall(text) for symbol in re.findall(r"`([^`]+)`", names)]


@pytest.fixture(scope="module")
def line_of():
    spec = importlib.util.spec_from_file_location("symbols", ROOT / "docs" / "site" / "symbols.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.line_of


@pytest.mark.parametrize(("page", "least"), [("model", 80), ("tour", 25)])
def test_places_in_the_code_exist(page, least, line_of):
    found = anchors(PAGES[page])
    assert len(found) > least
    assert not [place for place in found if not line_of(ROOT / place[0], place[1])]


@pytest.mark.parametrize("page", PAGES.values(), ids=list(PAGES))
def test_links_name_the_file_that_they_lead_to(page):
    links = re.findall(r"\[`([^`]+)`\]\((\.\.[^)]+)\)", page)
    assert links and not [link for link in links if f"../{link[0]}" != link[1]]


@pytest.mark.parametrize("page", PAGES.values(), ids=list(PAGES))
def test_every_link_to_code_is_followed_by_a_symbol(page):
    assert len(re.findall(r"\]\(\.\./[^)]+\.py\)", page)) == len(ANCHOR.findall(page))


def test_names_in_the_architecture_exist():
    packages = "|".join(path.parent.name for path in (ROOT / "ha2g_jax").glob("*/__init__.py"))
    page = (ROOT / "docs" / "architecture.md").read_text()
    names = {name for name in re.findall(rf"`((?:{packages})\.\w[\w.]*)`", page) if not name.startswith("config.")}
    assert len(names) > 10
    for name in names:
        pkgutil.resolve_name(f"ha2g_jax.{name}")


def test_a_symbol_that_is_gone_is_found(line_of):
    losses = ROOT / "ha2g_jax" / "methods" / "ha2g" / "losses.py"
    line = line_of(losses, "contrastive")
    assert losses.read_text().splitlines()[line - 1].startswith("def contrastive(")
    assert line_of(losses, "contrastive_of_old") is None
    assert line_of(losses.with_name("model.py"), "HA2G.infer") and line_of(losses, "HA2G.infer") is None


@pytest.mark.parametrize("number", range(1, 12))
def test_equation_leads_to_code(number):
    (text,) = [text for title, text in SECTIONS.items() if title.startswith(f"Eq. {number}: ")]
    assert text.count("$$") == 2 and anchors(text)


@pytest.mark.parametrize("number", range(1, 13))
def test_table_leads_to_code(number):
    (row,) = re.findall(rf"^\| Table {number} \|.*$", PAGE, re.MULTILINE)
    assert anchors(row)


def test_decisions_of_the_code_are_those_of_the_page():
    """The numbers in comments and docstrings are those that the page explains, each with its place."""
    decisions = {title.split(":")[0]: text for title, text in SECTIONS.items() if re.match(r"D\d+: ", title)}
    assert list(decisions) == [f"D{number}" for number in range(1, len(decisions) + 1)]
    assert all(anchors(text) for text in decisions.values())
    sources = [path.read_text() for path in (ROOT / "ha2g_jax").rglob("*.py")]
    named = {name for text in sources for name in re.findall(r"\bD\d{1,2}\b", text)}
    assert named <= set(decisions) and len(named) > 12
