"""Hook of MkDocs: files of the repository outside of docs/, where pages or the navigation link to them.

Links are written as GitHub reads them, `../ha2g_jax/skeleton.py`. In the site such a file has the path that it has in
the repository: Markdown and notebooks become pages, other text a page with its lines, and anything else is copied.

A link to a Python file may be followed by symbols, "[`PATH`](../PATH) `NAME`, `NAME`". They become links to the lines
on which they are defined.
"""

import base64
import mimetypes
import os
import pathlib
import posixpath
import re

import nbformat
import pygments.lexers
import pygments.util
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, InclusionLevel
from nbconvert import MarkdownExporter
from symbols import line_of

ROOT = pathlib.Path(__file__).parent.parent.parent
DOCS = ROOT / "docs"

_LINK = re.compile(r"(?<=\]\()([^)#\s:]+)(?=[)#\s])")
_SYMBOLS = re.compile(r"(\[`([^`\]]+\.py)`\]\((\S+?)\))((?:,?\s(?:and\s)?`[A-Za-z_][\w.]*`)+)")
_SYMBOL_LINK = re.compile(r'<a href="([^"]+)\.html"><code>([A-Za-z_][\w.]*)</code></a>')

_sources: dict[str, pathlib.Path] = {}  # file of the repository for each page of the site


def site_path(path: pathlib.Path) -> str:
    """Return the path of a file of the repository among the sources of the site."""
    if path.is_relative_to(DOCS):
        return path.relative_to(DOCS).as_posix()
    found = path.relative_to(ROOT).as_posix()
    return found if path.suffix == ".md" or not _is_text(path) else f"{found}.md"


def on_config(config):
    """Let the navigation name files outside of docs/ as links do."""
    config.nav = _mapped(config.nav)
    return config


@event_priority(100)
def on_files(files, config):
    """Add the files that the navigation and the pages link to, and those that these link to."""
    _sources.clear()
    pending = [DOCS / file.src_uri for file in files if file.src_uri.endswith(".md")]
    pending += _navigated
    while pending:
        path = pending.pop()
        uri = site_path(path)
        if uri in _sources:
            continue
        _sources[uri] = path
        if files.get_file_from_path(uri) is None:
            files.append(_file(path, uri, config))
        if path.suffix == ".md":
            pending += _targets(path, path.read_text(encoding="utf-8"))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turn links between files of the repository into links between pages of the site."""
    source = _sources[page.file.src_uri]
    if source.suffix not in (".md", ".ipynb"):
        return markdown

    def link(match: re.Match) -> str:
        path = _target(source, match[1])
        uri = path and site_path(path)
        if uri not in _sources:
            return match[0]
        return posixpath.relpath(uri, posixpath.dirname(page.file.src_uri) or ".")

    def symbols(match: re.Match) -> str:
        return match[1] + re.sub(r"`[^`]+`", lambda symbol: f"[{symbol[0]}]({match[3]})", match[4])

    return _LINK.sub(link, _SYMBOLS.sub(symbols, markdown))


def on_page_content(html, page, config, files):
    """Let the links of symbols lead to their lines."""

    def to_line(match: re.Match) -> str:
        uri = posixpath.normpath(posixpath.join(posixpath.dirname(page.file.url), match[1]))
        path = ROOT / uri
        line = line_of(path, match[2]) if path.suffix == ".py" and path.is_file() else None
        return match[0].replace('.html"', f'.html#__codelineno-0-{line}"') if line else match[0]

    return _SYMBOL_LINK.sub(to_line, html)


_navigated: list[pathlib.Path] = []


def _mapped(nav):
    if isinstance(nav, list):
        return [_mapped(item) for item in nav]
    if isinstance(nav, dict):
        return {title: _mapped(item) for title, item in nav.items()}
    path = pathlib.Path(os.path.normpath(DOCS / nav))
    if not path.is_file():
        return nav  # MkDocs says that there is no such file
    _navigated.append(path)
    return site_path(path)


def _targets(path: pathlib.Path, text: str) -> list[pathlib.Path]:
    """Return the files of the repository that a page links to."""
    return [target for match in _LINK.finditer(text) if (target := _target(path, match[1]))]


def _target(path: pathlib.Path, link: str) -> pathlib.Path | None:
    target = pathlib.Path(os.path.normpath(path.parent / link))
    if target == ROOT / "README.md":
        target = DOCS / "index.md"
    return target if target.is_file() and target.is_relative_to(ROOT) else None


def _file(path: pathlib.Path, uri: str, config) -> File:
    if path.suffix == ".ipynb":
        return File.generated(config, uri, content=_notebook(path))
    if path.suffix == ".md":
        return File.generated(config, uri, abs_src_path=str(path))
    source = {"content": _lines(path)} if uri.endswith(".md") else {"abs_src_path": str(path)}
    return File.generated(config, uri, inclusion=InclusionLevel.NOT_IN_NAV, **source)


def _is_text(path: pathlib.Path) -> bool:
    return b"\0" not in path.read_bytes()[:1024]


def _lexer(path: pathlib.Path) -> str:
    try:
        return pygments.lexers.get_lexer_for_filename(path.name).aliases[0]
    except pygments.util.ClassNotFound:
        return "text"


def _lines(path: pathlib.Path) -> str:
    """Return a page with the lines of a file, which the search leaves out."""
    name = path.relative_to(ROOT).as_posix()
    head = f"---\ntitle: {name}\nsearch:\n  exclude: true\nhide:\n  - toc\n---\n\n# `{name}`\n\n"
    fence = "`" * 12
    return f'{head}{fence}{_lexer(path)} linenums="1"\n{path.read_text(encoding="utf-8")}\n{fence}\n'


def _notebook(path: pathlib.Path) -> str:
    """Return a notebook and its stored output as Markdown, with pictures in the page."""
    body, resources = MarkdownExporter().from_notebook_node(nbformat.read(path, as_version=4))
    for name, data in resources["outputs"].items():
        body = body.replace(f"]({name})", f"]({_data_url(name, data)})")
    return body


def _data_url(name: str, data: bytes) -> str:
    kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
