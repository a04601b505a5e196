"""Code in the texts of a report: between backticks, as in Markdown."""

import re
from html import escape
from typing import Final

_CODE: Final = re.compile(r"`([^`]+)`")
_UNIT: Final = re.compile(r"\b[cm]?m/s\b")  # a line must not end in it


def html_text(text: str) -> str:
    """Return a text as HTML.

    >>> html_text("use `slipflow verify`, if a < b")
    'use <code>slipflow verify</code>, if a &lt; b'
    """
    return _UNIT.sub(r'<span class="unit">\g<0></span>', _CODE.sub(r"<code>\1</code>", escape(text)))


def plain_text(text: str) -> str:
    """Return a text without markup.

    >>> plain_text("use `slipflow verify`, if a < b")
    'use slipflow verify, if a < b'
    """
    return _CODE.sub(r"\1", text)
