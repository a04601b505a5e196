"""What several commands share: options, and how they say what they do."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Protocol

import typer

AsJson = Annotated[
    bool, typer.Option("--json", help="Print the result as one JSON object, and nothing else on stdout.")
]
Models = Annotated[
    list[Path] | None,
    typer.Option("--model", metavar="FILE", help="A model to take in as well; may be given several times."),
]
Names = Annotated[
    list[str] | None,
    typer.Option("--method", metavar="NAME", help="Only this method; may be given several times."),
]


def check_output_file(path: Path) -> None:
    """Make sure that a file can be put where it is to be: in a folder that is there. Other folders are made.

    Raises:
        EndpointError: if it is not.
    """
    from operators.errors import EndpointError  # noqa: PLC0415 - imports numpy

    if not path.parent.is_dir():
        raise EndpointError(str(path), f"there is no folder {path.parent}: make it, or write elsewhere")
    if path.is_dir():
        raise EndpointError(str(path), "is a folder: give the name of a file")


def told(text: str) -> None:
    """Say what is being done, beside the result."""
    typer.echo(text, err=True)


def counted(count: int, noun: str) -> str:
    """So many of something.

    >>> counted(1, "session"), counted(2000, "session")
    ('1 session', '2,000 sessions')
    """
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


class Update(Protocol):
    """Tells a bar how far the work is."""

    def __call__(self, done: int, of: int, part: str = "") -> None:
        """So many of so many are done, of a part of it."""
        ...


@contextmanager
def progress_bar(what: str) -> Generator[Update]:
    """A bar on stderr, where that is a screen."""
    from rich.console import Console  # noqa: PLC0415 - `slipflow --help` must not wait for it
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn  # noqa: PLC0415

    columns = *Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn()
    screen = Console(stderr=True)
    with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as bar:
        task = bar.add_task(what)

        def update(done: int, of: int, part: str = "") -> None:
            bar.update(task, description=f"{what} {part}".rstrip(), completed=done, total=of)

        yield update
