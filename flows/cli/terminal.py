"""Notes, progress and checks that several commands share."""

import logging
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import typer

from flows.cli.event_log import JsonFormatter

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


class Progress(Protocol):
    """Callback that updates a progress bar."""

    def __call__(self, done: int, total: int | None, part: str = "") -> None:
        """Show that `done` of `total` steps are done (None: of unknown), and the part in progress."""
        ...


@contextmanager
def progress_bar(action: str) -> Generator[Progress]:
    """Show a progress bar on stderr if it is a terminal; yield the callback that updates it."""
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
