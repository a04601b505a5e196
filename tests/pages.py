"""Reading of the documentation pages: fenced blocks, tables and commands."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", ROOT / "ARCHITECTURE.md", *(ROOT / "docs").rglob("*.md")])

_FENCE = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_COMMAND = re.compile(r"(?:^|[;&|]\s*|\bdo\s+)slipflow (?=[a-z-])")
_MENTIONED = re.compile(r"`slipflow ([a-z][^`]*)`")
_ENDS = {">", "|", ";", "&&", "||", ">>", "&"}


class Block(NamedTuple):
    """Fenced block."""

    language: str
    name: str  # file to save it as, after the language
    body: str


def blocks(page: Path) -> list[Block]:
    """Return the fenced blocks of a page in order."""
    return [Block(*found) for found in _FENCE.findall(page.read_text(encoding="utf-8"))]


def block(page: Path, name: str) -> str:
    """Return the block with this name."""
    [found] = [each.body for each in blocks(page) if each.name == name]
    return found


def table(page: Path, heading: str) -> list[dict[str, str]]:
    """Return the rows of the first table under a heading, by column."""
    section = page.read_text(encoding="utf-8").split(f"\n{heading}\n", 1)[1].split("\n#", 1)[0]
    lines = re.findall(r"^\|(.*)\|$", section, re.MULTILINE)
    cells = [[cell.strip() for cell in line.split("|")] for line in lines]
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def commands(page: Path) -> Iterator[list[str]]:
    """Yield the words after ``slipflow`` of each command in the page's code."""
    text, fenced = page.read_text(encoding="utf-8").replace("\\\n", " "), False
    for line in text.splitlines():
        if line.startswith("```"):
            fenced = not fenced
        elif fenced or line.startswith("    "):
            for found in _COMMAND.finditer(line.strip()):
                yield _words(line.strip()[found.end() :])


def mentioned(page: Path) -> Iterator[list[str]]:
    """Yield the words of each command in the page's prose, which may be incomplete."""
    for text in _MENTIONED.findall(page.read_text(encoding="utf-8")):
        yield _words(" ".join(text.split()))


def _words(text: str) -> list[str]:
    lexer = shlex.shlex(text, posix=True, punctuation_chars=True)
    lexer.whitespace_split, lexer.commenters = True, "#"
    words = list(lexer)
    end = next((number for number, word in enumerate(words) if word in _ENDS), len(words))
    return words[:end]
