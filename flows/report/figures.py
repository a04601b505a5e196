"""Figures in one style, as SVG files that are identical for identical data."""

import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import wraps
from html import escape
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeAlias

from operators.errors import InputError

Given = ParamSpec("Given")
Figure: TypeAlias = Any  # matplotlib lacks many type annotations
Axes: TypeAlias = Any

INK: Final = "#22272e"
FAINT: Final = "#9aa4b0"
SHADE: Final = "#f3d9b1"  # background of slip
MAIN: Final = "#0b6e99"
SECOND: Final = "#d1495b"
CELLS: Final = ("#0b6e99", "#e08e1b", "#2a9d5c", "#c2417c", "#7b5ea7", "#8a6d3b")  # cells 0 to 5
_DPI: Final = 110  # of .png, and of images in .svg
STYLE: Final[Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Helvetica", "Arial", "sans-serif"],
    "font.size": 9,
    "text.color": INK,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "grid.color": "#e6e9ed",
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.fonttype": "none",
    "svg.hashsalt": "slipflow",
}


def missing_matplotlib() -> str:
    """Return why figures cannot be drawn, with the remedy; empty if matplotlib is installed."""
    return "" if find_spec("matplotlib") else "need matplotlib: in the clone, pip install -e '.[report]'"


def require() -> None:
    """Check that matplotlib is installed.

    Raises:
        InputError: if matplotlib is not installed.
    """
    if reason := missing_matplotlib():
        raise InputError("figures", reason)


def styled(draw: Callable[Given, Figure]) -> Callable[Given, Figure]:
    """Decorate a function that draws a figure so that it uses the project's style.

    Raises:
        InputError: when the function is called and matplotlib is not installed.
    """

    @wraps(draw)
    def drawn(*args: Given.args, **kwargs: Given.kwargs) -> Figure:
        require()
        with _style():
            return draw(*args, **kwargs)

    return drawn


def grid(
    rows: int,
    columns: int,
    size: tuple[float, float],
    *,
    sharex: bool = False,
    sharey: bool = False,
    heights: Sequence[float] | None = None,
    widths: Sequence[float] | None = None,
) -> tuple[Figure, list[Axes]]:
    """Return a figure of `size` inches and its panels, row by row; for use in `styled` functions."""
    from matplotlib import figure as matplotlib  # noqa: PLC0415

    figure: Figure = matplotlib.Figure(figsize=size, layout="constrained")
    axes = figure.subplots(
        rows, columns, squeeze=False, sharex=sharex, sharey=sharey, height_ratios=heights, width_ratios=widths
    )
    return figure, list(axes.flat)


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the path's suffix: .svg or .png.

    Raises:
        OSError: if it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with _style():
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None, dpi=_DPI)


def svg(figure: Figure) -> str:
    """Return a figure as the text of an SVG file."""
    drawn = StringIO()
    with _style():
        figure.savefig(drawn, format="svg", metadata={"Date": None}, dpi=_DPI)
    return drawn.getvalue()


def inline(drawn: str, name: str, text: str) -> str:
    """Return an SVG file as an element of an HTML page, without prolog and external references.

    Args:
        drawn: Text of the file.
        name: Letters and hyphens; prefix that makes the identifiers unique on a page with several figures.
        text: Description for screen readers.
    """
    _, _, element = drawn.partition("<svg ")
    head, _, body = element.partition(">")
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", body.replace("xlink:href", "href"))
    size = re.search(r'viewBox="[^"]+"', head)
    assert size, "matplotlib writes the size of a figure"
    return f'<svg {size[0]} role="img" aria-label="{escape(text)}">{body}'


def _style() -> AbstractContextManager[None]:
    import matplotlib as mpl  # noqa: PLC0415 - an extra, and slow to import

    library: Any = mpl
    context: AbstractContextManager[None] = library.rc_context(STYLE)
    return context
