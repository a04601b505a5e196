"""Figures in one style, as SVG files that are identical for identical data."""

from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any, Final, TypeAlias

from operators.extras import install_command, is_installed

Figure: TypeAlias = Any  # matplotlib lacks many type annotations
Axes: TypeAlias = Any

SOFT: Final = "#5b6672"  # of text
FAINT: Final = "#9aa4b0"  # of lines
GROUND: Final = "#ffffff"
MAIN: Final = "#0b6e99"
MORE: Final = (  # for many lines in a panel
    *(MAIN, "#e08e1b", "#2a9d5c", "#c2417c", "#7b5ea7", "#8a6d3b"),
    *("#d1495b", "#22272e", "#5ab4ac", "#b5a642", "#6c8ebf", FAINT),
)
WIDTH: Final = 11.0  # inches, the most that fits on a page
_ROW_GAP: Final = 0.08  # inches above and below each panel
_STYLE: Final = Path(__file__).with_suffix(".mplstyle")
_DPI: Final = 110  # of .png, and of images in .svg


def missing_matplotlib() -> str:
    """Return why figures cannot be drawn, with the remedy; empty if matplotlib is installed."""
    return "" if is_installed("report") else f"need matplotlib: {install_command('report')}"


def grid(
    rows: int, columns: int, size: tuple[float, float], *, sharex: bool = False, sharey: bool = False
) -> tuple[Figure, list[Axes]]:
    """Return a figure of `size` inches and its panels, row by row."""
    from matplotlib import figure as matplotlib

    figure: Figure = matplotlib.Figure(figsize=size, layout="constrained")
    figure.get_layout_engine().set(h_pad=_ROW_GAP)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=sharex, sharey=sharey)
    return figure, list(axes.flat)


def svg(draw: Callable[[], Figure]) -> str:
    """Draw a figure in the project's style, which needs matplotlib; return the text of its SVG file."""
    import matplotlib as mpl

    library: Any = mpl
    text = StringIO()
    with library.rc_context(fname=_STYLE):
        draw().savefig(text, format="svg", metadata={"Date": None}, dpi=_DPI)
    return text.getvalue()
