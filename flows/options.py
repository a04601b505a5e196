"""What several commands share: options, and how their values are read."""

import re
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Protocol

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object on the last line.")]
Models = Annotated[
    list[Path] | None,
    typer.Option("--model", metavar="FILE", help="A model to take in as well; may be given several times."),
]
Names = Annotated[
    list[str] | None,
    typer.Option("--method", metavar="NAME", help="Only this method; may be given several times."),
]


def nanoseconds(duration: str | None) -> int | None:
    """A duration as a person writes it.

    >>> nanoseconds("1.5s")
    1500000000
    """
    if duration is None:
        return None
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(ms|s|min|h)", duration.strip())
    if match is None:
        raise typer.BadParameter(f"{duration!r} is no time: write it as 500ms, 30s, 5min or 1h")
    return round(float(match[1]) * {"ms": 1e6, "s": 1e9, "min": 60e9, "h": 3600e9}[match[2]])


def newtons(force: str) -> float:
    """A force as a person writes it.

    >>> newtons("2.5N")
    2.5
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*N", force.strip())
    if match is None:
        raise typer.BadParameter(f"{force!r} is no force: write it as 2N or 0.5N")
    return float(match[1])


def metres(length: str) -> float:
    """A length as a person writes it.

    >>> metres("1.5mm")
    0.0015
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(mm|m)", length.strip())
    if match is None:
        raise typer.BadParameter(f"{length!r} is no length: write it as 1.5mm or 0.0015m")
    return float(match[1]) / {"mm": 1000, "m": 1}[match[2]]


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
