"""Colours of pages and figures, light and dark."""

import re
from collections.abc import Mapping
from typing import Final

PALETTE: Final[Mapping[str, tuple[str, str]]] = {  # by name: light, dark
    "ground": ("#ffffff", "#14181d"),
    "ink": ("#22272e", "#e6eaee"),
    "soft": ("#5b6672", "#a3aeb9"),  # secondary text
    "faint": ("#9aa4b0", "#66717d"),  # lines, never text
    "grid": ("#e6e9ed", "#2b333b"),
    "shade": ("#f3d9b1", "#4c3a1a"),  # background of slip
    "panel": ("#f5f7f9", "#1c2229"),  # background of code
    "main": ("#0b6e99", "#5bb8e8"),
    "second": ("#d1495b", "#ff8391"),
    "amber": ("#e08e1b", "#f0a94a"),
    "green": ("#2a9d5c", "#54c98a"),
    "magenta": ("#c2417c", "#ec7fb0"),
    "violet": ("#7b5ea7", "#b39ade"),
    "brown": ("#8a6d3b", "#c4a572"),
    "teal": ("#5ab4ac", "#7fd3cb"),
    "olive": ("#b5a642", "#d2c465"),
    "steel": ("#6c8ebf", "#93b0da"),
}
_NAMES: Final = {light: name for name, (light, _) in PALETTE.items()}


def light(name: str) -> str:
    """Return a colour of the light palette.

    >>> light("ink")
    '#22272e'
    """
    return PALETTE[name][0]


def variables() -> str:
    """Return a style sheet that defines the palette as variables, for light and dark."""
    both = [" ".join(f"--{name}: {each[dark]};" for name, each in PALETTE.items()) for dark in (0, 1)]
    return (
        f":root {{ color-scheme: light dark; {both[0]} }}\n"
        f"@media (prefers-color-scheme: dark) {{ :root {{ {both[1]} }} }}"
    )


def with_variables(drawn: str) -> str:
    """Replace the palette's colours in the styles of a figure by variables; other colours stay.

    >>> with_variables('style="fill: #22272e; stroke: #123456"')
    'style="fill: var(--ink); stroke: #123456"'
    """

    def variable(found: re.Match[str]) -> str:
        name = _NAMES.get(found[0])
        return f"var(--{name})" if name else found[0]

    return re.sub(r"(?<=: )#[0-9a-f]{6}\b", variable, drawn)
