"""Charts of curves as inline SVG by matplotlib, whose colours are variables of the page's style sheet."""

import html
import io
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.train.report.curves import Curve, is_logarithmic

NUM_COLOURS = 7  # --line-0 to --line-6 of the page
DASHES = ((), (7, 3), (2, 2), (7, 2, 2, 2))  # in points; of lines 0 to 6, 7 to 13, ...

_SIZE = (4.8, 2.6)  # inches of 72 points
_AXES = (0.115, 0.165, 0.875, 0.81)  # left, bottom, width and height as fractions of the picture
_FEW_DECADES = 1000.0  # ratio of the ends of an axis up to which 2 and 5 are marked beside the powers of ten
_FLAT = 1e-6  # range of an axis, relative to its values, up to which they are equal but for rounding
_MOST_MARKERS = 60  # points of a curve that are marked
# Colours that matplotlib writes, in place of which the page's variables are put.
_VARIABLES = {f"#0102{number:02x}": f"var(--line-{number})" for number in range(NUM_COLOURS)}
_VARIABLES |= {"#010300": "var(--quiet)", "#010301": "var(--line)"}
_INK, _GRID = list(_VARIABLES)[-2:]


def check_matplotlib() -> None:
    """Check that matplotlib is installed, which is an extra.

    Raises:
        UserError: it is not.
    """
    try:
        import matplotlib  # noqa: F401
    except ModuleNotFoundError:
        raise UserError("ha2g plot needs matplotlib, which is missing; pip install 'ha2g-jax[plot]'") from None


def colour(number: int) -> str:
    """Return the CSS colour of a line by its number."""
    return f"var(--line-{number % NUM_COLOURS})"


def dashes(number: int) -> tuple[int, ...]:
    """Return the dashes of a line by its number, () for a solid one."""
    return DASHES[number // NUM_COLOURS % len(DASHES)]


def curve_chart(
    curves: Sequence[Curve], label: str, steps: tuple[float, float], values: tuple[float, float], *, name: str
) -> str:
    """Draw curves over steps; each has a title, which browsers show under the pointer, and a class "line-N".

    A line is solid where all of its runs have a value and faint where some have none. Few points are marked. An axis
    of positive values of more than one order of magnitude is logarithmic.

    Args:
        curves: at least one curve.
        label: description of the chart for screen readers.
        steps: first and last step of the horizontal axis.
        values: least and greatest value of the vertical axis, which gets a margin.
        name: text that no other chart of the page has, for ids.

    Returns:
        An SVG element, the same for the same curves.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "font.size": 9, "path.simplify": False}):
        figure = Figure(figsize=_SIZE)
        axes = figure.add_axes(_AXES)
        _set_up(axes, steps, values)
        for curve in curves:
            _draw(axes, curve)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", transparent=True)
    return _for_page(buffer.getvalue(), label, curves)


def _set_up(axes: Any, steps: tuple[float, float], values: tuple[float, float]) -> None:
    from matplotlib.ticker import EngFormatter, LogLocator, MaxNLocator, NullLocator

    low, high = values
    if is_logarithmic(low, high):
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high / low < _FEW_DECADES else (1,)))
        axes.yaxis.set_minor_locator(NullLocator())
        margin = (high / low) ** 0.06
        axes.set_ylim(low / margin, high * margin)
    else:
        is_flat = high - low <= _FLAT * max(abs(low), abs(high))
        margin = (0.5 * abs(high) or 1.0) if is_flat else 0.06 * (high - low)
        axes.set_ylim(low - margin, high + margin)
    margin = 0.02 * (steps[1] - steps[0]) or 1.0
    axes.set_xlim(steps[0] - margin, steps[1] + margin)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("step", color=_INK)
    axes.grid(color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(which="both", length=0, labelcolor=_INK)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.spines["bottom"].set_color(_INK)


def _draw(axes: Any, curve: Curve) -> None:
    paint = f"#0102{curve.number % NUM_COLOURS:02x}"
    style = {"color": paint, "gid": f"line-{curve.number}"}
    if curve.logged is not None and not np.array_equal(curve.logged.values, curve.mean):
        axes.plot(curve.logged.steps, curve.logged.values, linewidth=0.6, alpha=0.35, **style)
    if curve.low is not None:
        axes.fill_between(curve.steps, curve.low, curve.high, alpha=0.22, linewidth=0, **style)
    marks = {"marker": "o", "markersize": 3} if len(curve.steps) <= _MOST_MARKERS else {}
    pattern = (0, dashes(curve.number)) if dashes(curve.number) else "solid"
    whole, rest = (np.where(mask, curve.mean, np.nan) for mask in (curve.is_whole, ~_inner(curve.is_whole)))
    axes.plot(curve.steps, whole, linewidth=1.6, linestyle=pattern, **marks, **style)
    if not curve.is_whole.all():
        axes.plot(curve.steps, rest, linewidth=1.6, linestyle=pattern, alpha=0.45, **style)


def _inner(mask: np.ndarray) -> np.ndarray:
    """Return a mask without the places beside others, so that the part outside of it joins the part inside."""
    return mask & np.append(mask[1:], True) & np.insert(mask[:-1], 0, True)


def _for_page(text: str, label: str, curves: Sequence[Curve]) -> str:
    """Return an SVG document as an element of a page, with fewer digits, variables for colours and titles of lines."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r' id="(?!line-|[mpc][0-9a-f]{10})[^"]*"', "", text)
    text = re.sub(r"<[^>]*>", lambda tag: re.sub(r"(\d\.\d)\d+", r"\1", tag[0]), text)
    text = re.sub(r"font-family: [^;]*; ", "", text)
    for written, variable in _VARIABLES.items():
        text = text.replace(written, variable)
    for curve in curves:
        title = html.escape(curve.label)
        text = text.replace(f'<g id="line-{curve.number}">', f'<g class="line-{curve.number}"><title>{title}</title>')
    shown = html.escape(label)
    view = re.search(r'viewBox="[^"]*"', text)
    assert view is not None
    head = f'<svg {view[0]} role="img" aria-label="{shown}" xmlns:xlink="http://www.w3.org/1999/xlink"><title>{shown}</title>'
    return re.sub(r"\n\s*", "\n", re.sub(r"^<svg[^>]*>", lambda _: head, text)).strip()
