"""The documentation site: its navigation has every page, and nothing on a page is loaded from elsewhere."""

import os
import pathlib
import re

import pytest
import yaml

import ha2g_jax

ROOT = pathlib.Path(__file__).parent.parent
DOCS = ROOT / "docs"
CONFIG = yaml.safe_load((ROOT / "mkdocs.yml").read_text())


def paths(nav):
    if isinstance(nav, str):
        return [nav]
    return [path for item in (nav.values() if isinstance(nav, dict) else nav) for path in paths(item)]


NAVIGATION = [pathlib.Path(os.path.normpath(DOCS / path)) for path in paths(CONFIG["nav"])]


def test_every_page_is_in_the_navigation():
    pages = {*DOCS.rglob("*.md"), *(ROOT / "notebooks").glob("*.ipynb")}
    missing = sorted(str(path.relative_to(ROOT)) for path in pages - set(NAVIGATION))
    assert not missing, f"add to nav in mkdocs.yml: {', '.join(missing)}"


def test_the_navigation_has_each_file_once():
    assert len(NAVIGATION) == len(set(NAVIGATION))
    assert not [path for path in NAVIGATION if not path.is_file()]


def test_broken_links_and_anchors_are_errors():
    """`make docs` is strict, which makes errors of warnings."""
    assert "mkdocs build --strict" in (ROOT / "Makefile").read_text()
    links = CONFIG["validation"]["links"]
    assert {links[name] for name in ("not_found", "anchors", "unrecognized_links")} == {"warn"}


def test_the_site_loads_nothing_from_elsewhere():
    assert CONFIG["theme"]["font"] is False
    loaded = [*CONFIG["extra_css"], *CONFIG["extra"]["polyfills"], *CONFIG.get("extra_javascript", [])]
    assert loaded and all((DOCS / path).is_file() for path in loaded)


@pytest.mark.parametrize("page", sorted((DOCS / "api").glob("*.md")), ids=lambda page: page.stem)
def test_modules_of_the_reference_exist(page):
    names = re.findall(r"^::: (\S+)$", page.read_text(), re.MULTILINE)
    assert names
    for name in names:
        path = ROOT.joinpath(*name.split("."))
        if not (path / "__init__.py").is_file() and not path.with_suffix(".py").is_file():
            source = path.parent.with_suffix(".py").read_text()
            assert re.search(rf"^(?:def|class) {path.name}\b", source, re.MULTILINE), name


def test_the_citation_names_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == ha2g_jax.__version__
    assert f"version = {{{ha2g_jax.__version__}}}" in (DOCS / "cite.md").read_text()
    paper = citation["preferred-citation"]
    assert (ROOT / "README.md").read_text().count(paper["title"]) >= 1 and len(paper["authors"]) == 10
