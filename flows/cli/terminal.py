"""Output of the commands: log of a run, notes, progress and reports."""

import logging
import shlex
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from flows.report.report_page import Report

log = logging.getLogger("slipflow")


def begin_log() -> None:
    """Send log records to stderr."""
    log.setLevel(logging.INFO)
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr)


def note(text: str) -> None:
    """Print a message on stderr, as stdout is for the result."""
    typer.echo(text, err=True)


@contextmanager
def progress_bar(action: str) -> Generator[Callable[..., None]]:
    """Show a progress bar on stderr if it is a terminal; yield the callback that updates it.

    Its arguments are the finished steps, all steps (None: of unknown number), and the part in progress.
    """
    from rich import progress
    from rich.console import Console

    more = progress.MofNCompleteColumn(), progress.TimeElapsedColumn()
    columns, console = (*progress.Progress.get_default_columns(), *more), Console(stderr=True)
    hidden = not console.is_terminal
    with progress.Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task(action)

        def update(done: int, total: int | None, part: str = "") -> None:
            bar.update(task, description=f"{action} {part}".rstrip(), completed=done, total=total)

        yield update


def command_line() -> str:
    """Return the command that the user typed, for a report."""
    return shlex.join(["slipflow", *sys.argv[1:]])


def write_report(report: "Report", folder: Path, name: str) -> None:
    """Write a report as NAME.html, .md, .json and figures; print its tables."""
    paths = report.write(folder, name)
    note(f"wrote {', '.join(map(str, paths))}")
    typer.echo(report.terminal())
