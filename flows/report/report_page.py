"""Reports: findings with text, tables and figures, written as HTML, Markdown, JSON and terminal text."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, Final

from flows.report.colours import variables
from flows.report.figures import Figure, inline, missing_matplotlib, svg
from flows.report.markup import html_text, plain_text
from flows.report.table import Table
from operators.errors import EndpointError, os_error_reason

_STYLE: Final = Path(__file__).with_suffix(".css")


@dataclass(frozen=True)
class Section:
    """Finding with its evidence."""

    name: str  # letters, digits and hyphens; names the figure's file and the JSON key
    finding: str  # one sentence with numbers
    text: str  # how it was measured
    tables: Sequence[Table] = ()
    draw: Callable[[], Figure] | None = None  # called at most once, and only if matplotlib is installed
    terminal: bool = True  # False: left out of the terminal text

    @cached_property
    def svg(self) -> str:
        """Figure as the text of an SVG file; empty if there is none or matplotlib is not installed."""
        return "" if self.draw is None or missing_matplotlib() else svg(self.draw())

    def html(self) -> str:
        """Return the section as an HTML element."""
        parts = [f"<h2>{html_text(self.finding)}</h2>", f"<p>{html_text(self.text)}</p>"]
        if self.svg:
            parts.append(inline(self.svg, self.name, self.finding))
        body = "\n".join([*parts, *(table.html() for table in self.tables)])
        return f'<section id="{self.name}">\n{body}\n</section>'

    def markdown(self, figure: str) -> str:
        """Return the section as Markdown; the file `figure` holds its figure."""
        shown = [f"![{self.finding}]({figure})"] if self.svg else []
        return "\n\n".join([f"## {self.finding}", self.text, *shown, *(t.markdown() for t in self.tables)])


@dataclass(frozen=True)
class Report:
    """Findings of a study and the command that produced them."""

    title: str
    text: str
    sections: Sequence[Section]
    command: str
    facts: Mapping[str, Any] = field(default_factory=dict[str, Any])  # subject of the study, for the JSON

    def html(self) -> str:
        """Return one self-contained HTML page."""
        sections = "\n".join(section.html() for section in self.sections)
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{escape(plain_text(self.title))}</title>\n"
            f"<style>{variables()}\n{_STYLE.read_text()}</style>\n</head>\n<body>\n"
            f"<h1>{html_text(self.title)}</h1>\n<p>{html_text(self.text)}</p>\n{self._contents()}\n{sections}\n"
            f"<footer>Printed by<pre>{escape(self.command)}</pre></footer>\n</body>\n</html>\n"
        )

    def markdown(self, name: str) -> str:
        """Return the page as Markdown; figures are files next to NAME.md."""
        parts = [section.markdown(_figure_file(name, section)) for section in self.sections]
        return (
            "\n\n".join([f"# {self.title}", self.text, *parts, "Printed by:", f"    {self.command}"]) + "\n"
        )

    def json(self) -> dict[str, Any]:
        """Return facts, findings and tables as JSON data; unknown values are null."""
        found = {
            section.name: {
                "finding": plain_text(section.finding),
                "tables": [table.json() for table in section.tables],
            }
            for section in self.sections
        }
        return {"title": plain_text(self.title), "command": self.command, **self.facts, "sections": found}

    def terminal(self) -> str:
        """Return the findings and tables as text for a terminal."""
        shown = [section for section in self.sections if section.terminal]
        parts = [[plain_text(section.finding), *(t.markdown() for t in section.tables)] for section in shown]
        return "\n\n".join("\n\n".join(each) for each in parts)

    def _contents(self) -> str:
        """Return the table of contents, which lists the findings."""
        links = [f'<li><a href="#{each.name}">{html_text(each.finding)}</a></li>' for each in self.sections]
        lines = "\n".join(links)
        return f'<nav aria-label="Contents"><p>Contents</p><ol>\n{lines}\n</ol></nav>'

    def write(self, folder: Path, name: str) -> list[Path]:
        """Write NAME.html, NAME.md, NAME.json and the figures (SVG) into a folder; return their paths.

        Raises:
            EndpointError: if they cannot be written.
        """
        make_output_folder(folder)
        numbers = json.dumps(self.json(), indent=1, allow_nan=False) + "\n"
        texts = {"html": self.html(), "md": self.markdown(name), "json": numbers}
        paths = [folder / f"{name}.{ending}" for ending in texts]
        try:
            for path, text in zip(paths, texts.values(), strict=True):
                path.write_text(text, encoding="utf-8")
            for section in self.sections:
                if section.svg:
                    paths.append(folder / _figure_file(name, section))
                    paths[-1].write_text(section.svg, encoding="utf-8")
        except OSError as error:
            raise EndpointError(str(folder), f"cannot be written: {os_error_reason(error)}") from error
        return paths


def make_output_folder(folder: Path) -> None:
    """Create the folder that results are written to.

    Raises:
        EndpointError: if it cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be created: {os_error_reason(error)}") from error


def check_output_folder(folder: Path) -> None:
    """Check before a long measurement that files can be created in a folder; leave no folder behind.

    Raises:
        EndpointError: if it cannot be created or written.
    """
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    make_output_folder(folder)
    try:
        TemporaryFile(dir=folder).close()
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be written: {os_error_reason(error)}") from error
    finally:
        with suppress(OSError):  # another process has written to it
            for each in missing:
                each.rmdir()


def _figure_file(page: str, section: Section) -> str:
    return f"{page}.svg" if section.name == page else f"{page}-{section.name}.svg"
