"""Notes, progress, checks and reports that several commands share."""

import json
import logging
import shlex
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from flows.cli.event_log import JsonFormatter

if TYPE_CHECKING:
    from flows.report.report_page import Report

log = logging.getLogger("slipflow")


def note(text: str) -> None:
    """Print a message on stderr, as stdout is for the result; a JSON log gets it as a record."""
    if any(isinstance(each.formatter, JsonFormatter) for each in logging.root.handlers):
        message = text.removeprefix("error: ")
        log.log(logging.INFO if message == text else logging.ERROR, "%s", message)
    else:
        typer.echo(text, err=True)


def check_output_file(path: Path) -> None:
    """Require that a file can be created at `path`: its folder exists, and `path` is not a folder.

    Raises:
        EndpointError: if it cannot.
    """
    from operators.errors import EndpointError

    if not path.parent.is_dir():
        raise EndpointError(str(path), f"folder {path.parent} does not exist: create it, or write elsewhere")
    if path.is_dir():
        raise EndpointError(str(path), "is a folder: give a file name")


@contextmanager
def progress_bar(action: str) -> Generator[Callable[..., None]]:
    """Show a progress bar on stderr if it is a terminal; yield the callback that updates it.

    Its arguments are the finished steps, all steps (None: of unknown number), and the part in progress.
    """
    from rich import progress
    from rich.console import Console

    columns = *progress.Progress.get_default_columns(), progress.MofNCompleteColumn()
    console = Console(stderr=True)
    with progress.Progress(
        *columns,
        progress.TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bar:
        task = bar.add_task(action)

        def update(done: int, total: int | None, part: str = "") -> None:
            bar.update(task, description=f"{action} {part}".rstrip(), completed=done, total=total)

        yield update


def command_line() -> str:
    """Return the command that the user typed, for a report."""
    return shlex.join(["slipflow", *sys.argv[1:]])


def prepare_report(folder: Path) -> None:
    """Create the folder of a report before a long measurement; note that figures need matplotlib.

    Raises:
        EndpointError: if the folder cannot be created or written.
    """
    from flows.report.figures import missing_matplotlib
    from flows.report.report_page import make_output_folder

    make_output_folder(folder)
    if reason := missing_matplotlib():
        note(f"the report will have no figures, which {reason}")


def write_report(report: "Report", folder: Path, name: str, *, as_json: bool) -> None:
    """Write a report as NAME.html, .md, .json and figures; print its tables."""
    paths = report.write(folder, name)
    note(f"wrote {', '.join(map(str, paths))}")
    typer.echo(json.dumps(report.json(), allow_nan=False) if as_json else report.terminal())
