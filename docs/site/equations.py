r"""Hook of MkDocs: equations become MathML, which browsers draw without a script or a font from elsewhere.

`pymdownx.arithmatex` finds them, written as GitHub reads them: $...$ in a line, $$...$$ by themselves.
"""

import html
import logging
import re

from latex2mathml.converter import convert

_EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)

_logger = logging.getLogger("mkdocs.hooks.equations")


def on_page_content(content, page, config, files):
    """Replace the equations of a page."""
    return _EQUATION.sub(_mathml, content)


def _mathml(match: re.Match) -> str:
    tag, bracket, latex = match.groups()
    equation = convert(html.unescape(latex).strip(), display="block" if bracket == "[" else "inline")
    if "\\" in equation:  # what the converter does not know, it leaves as it is
        _logger.warning("an equation has a command that is not known: %s", latex)
    return f'<{tag} class="equation">{equation}</{tag}>'
