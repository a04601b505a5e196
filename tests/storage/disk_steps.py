"""Steps of storage on the disk, which tests observe, fail or hold up."""

import os
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from operators.batch import BAROMETERS, EVERY, Batch, Episodes, Motion, Slips, Touch, ms
from operators.ports import Run
from storage import files
from storage.journal import APPEND_AT
from storage.writer import SessionWriter
from tests.storage.made import new_episodes

STREAMS: tuple[tuple[type[Batch], int], ...] = ((Touch, 0), (Motion, EVERY), (Slips, 0), (Episodes, EVERY))
ROWS = 45  # of each stream
SYNC_EVERY = 7  # rows
KINDS = {".parquet": "part", ".wal": "segment"}
CHANGES = ("pwrite", "fsync", "ftruncate", "replace", "rename", "unlink", "mkdir", "rmdir", "open")


@contextmanager
def observed(reach: Callable[[str], None]) -> Generator[None]:
    """Call `reach` with the name of each step before it changes the disk."""

    def wrapped(name: str, real: Callable[..., object]) -> Callable[..., object]:
        def call(where: Any, *rest: Any, **named: Any) -> object:
            path = Path(f"/proc/self/fd/{where}").readlink() if isinstance(where, int) else Path(where)
            if name != "open" or rest[0] & os.O_EXCL:
                reach(f"{name} {_kind(path)}")
            return real(where, *rest, **named)

        return call

    with ExitStack() as stack:
        for name in CHANGES:
            stack.enter_context(patch.object(os, name, wrapped(name, getattr(os, name))))
        yield


def steps_of(work: Callable[[], object]) -> list[str]:
    """Return the steps of a piece of work."""
    found = list[str]()
    with observed(found.append):
        work()
    return found


def each_kind(steps: list[str], turns: tuple[int, ...] = (0, 2), every: int = 9) -> Iterator[int]:
    """Yield the first and third step of each name, and every ninth of all."""
    for number, step in enumerate(steps):
        if steps[:number].count(step) in turns or number % every == 0:
            yield number


def row(kind: type[Batch], number: int) -> Batch:
    """Return row `number` of a stream."""
    time = number * 10 * ms
    if kind is Touch:
        return Touch.rows([time], [[number] * BAROMETERS], number, number > 0, finger=0)
    if kind is Motion:
        return Motion.rows([time], time, number, number)
    if kind is Slips:
        return Slips.rows([time], number % 2, time, number / 100, finger=0)
    return new_episodes((time, time + 10 * ms, "tap"))


def record(root: Path, run: Run, taken: list[int], durable: list[int] | None = None) -> None:
    """Record as a sink does, without its tasks.

    `taken` gets the number of each row that was accepted, `durable` the number of rows after each fsync.
    """
    root.mkdir()
    writer = SessionWriter(root, run, part_span=100 * ms, part_rows=8)
    for number in range(ROWS):
        for kind, _ in STREAMS:
            batch = row(kind, number)
            while writer.full(batch):
                writer.commit()
            if not writer.add(batch):
                writer.append(batch)
        if writer.journal and number % APPEND_AT == APPEND_AT - 1:
            writer.append()
        if writer.journal and number % SYNC_EVERY == 0:
            writer.append()
            writer.journal.sync()
            if durable is not None:
                durable.append(number + 1)
        taken.append(number)
    writer.close()


def _kind(path: Path) -> str:
    """Return the kind of a file or folder.

    >>> _kind(Path("touch/part-000000.parquet.tmp")), _kind(Path("session.json"))
    ('new part', 'session')
    """
    new = path.suffix == files.SCRATCH
    path = path.with_suffix("") if new else path
    return ("new " if new else "") + KINDS.get(path.suffix, path.stem.lower())
