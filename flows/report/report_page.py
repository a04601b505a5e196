"""Reports: short notes, tables and figures, as Markdown, and as HTML, JSON and text that come from it."""

import json
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, Final

from jinja2 import Environment
from markdown_it import MarkdownIt

from flows.report.figures import Figure, missing_matplotlib, svg
from flows.report.table import Table
from storage.files import write_errors

_TEMPLATE: Final = Path(__file__).with_suffix(".html.jinja")


@dataclass(frozen=True)
class Section:
    """Tables and a figure with a heading and a note."""

    name: str  # letters, digits and hyphens; names the figure's file and the JSON key
    finding: str  # heading
    text: str  # how it was measured
    tables: Sequence[Table] = ()
    draw: Callable[[], Figure] | None = None  # called at most once, and only if matplotlib is installed
    folded: bool = False  # in HTML, until a reader opens it

    @cached_property
    def svg(self) -> str:
        """Figure as the text of an SVG file; empty if there is none or matplotlib is not installed."""
        return "" if self.draw is None or missing_matplotlib() else svg(self.draw)

    def markdown(self, figure: str) -> str:
        """Return the section without its heading as Markdown; `figure` is the address of its figure."""
        shown = [f"![{self.finding}]({figure})"] if self.svg else []
        return "\n\n".join(filter(None, [self.text, *shown, *(t.markdown() for t in self.tables)]))


@dataclass(frozen=True)
class Report:
    """Tables of a study and the command that produced them."""

    title: str
    text: str
    sections: Sequence[Section]
    command: str

    def markdown(self, name: str) -> str:
        """Return the page as Markdown; figures are files next to NAME.md."""
        parts = [f"## {each.finding}\n\n{each.markdown(_figure_file(name, each))}" for each in self.sections]
        head = filter(None, [f"# {self.title}", self.text])
        return "\n\n".join([*head, *parts, "Printed by:", f"    {self.command}"]) + "\n"

    def html(self) -> str:
        """Return one self-contained HTML page; its figures are images in the page."""
        markdown = MarkdownIt("commonmark", {"html": False}).enable("table")

        def body(section: Section) -> str:
            image = b64encode(section.svg.encode()).decode()
            text: str = markdown.render(section.markdown("figure"))
            return text.replace('src="figure"', f'src="data:image/svg+xml;base64,{image}"')

        page = Environment(autoescape=True).from_string(_TEMPLATE.read_text(encoding="utf-8"))
        return page.render(report=self, body=body)

    def json(self) -> dict[str, Any]:
        """Return the command and tables as JSON data; unknown values are null."""
        found = {
            section.name: {"finding": section.finding, "tables": [table.json() for table in section.tables]}
            for section in self.sections
        }
        return {"title": self.title, "notes": self.text, "command": self.command, "sections": found}

    def terminal(self) -> str:
        """Return the headings and tables as text for a terminal."""
        parts = [[section.finding, *(t.markdown() for t in section.tables)] for section in self.sections]
        return "\n\n".join("\n\n".join(each) for each in parts)

    def write(self, folder: Path, name: str) -> list[Path]:
        """Write NAME.html, NAME.md, NAME.json and the figures (SVG) into a folder; return their paths.

        Raises:
            EndpointError: if they cannot be written.
        """
        numbers = json.dumps(self.json(), indent=1, allow_nan=False) + "\n"
        texts = {f"{name}.html": self.html(), f"{name}.md": self.markdown(name), f"{name}.json": numbers}
        texts |= {_figure_file(name, each): each.svg for each in self.sections if each.svg}
        with write_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for file, text in texts.items():
                (folder / file).write_text(text, encoding="utf-8")
        return [folder / file for file in texts]


def check_output_folder(folder: Path) -> None:
    """Check that results can be written to a folder, or that it can be created, without creating it.

    Raises:
        EndpointError: if not.
    """
    with write_errors(folder):
        existing = next(each for each in (folder, *folder.absolute().parents) if each.exists())
        TemporaryFile(dir=existing).close()


def _figure_file(page: str, section: Section) -> str:
    return f"{page}.svg" if section.name == page else f"{page}-{section.name}.svg"
