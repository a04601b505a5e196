"""Runs, batches and sessions to test with."""

import asyncio
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flows.run.clocks import EventClock
from operators.batch import (
    BAROMETERS,
    EVERY,
    MOTIONS,
    AnyBatch,
    Batch,
    Episodes,
    Labelled,
    Motion,
    Slips,
    Touch,
    columns,
    concat,
    ms,
    s,
)
from operators.fingertip import Fingertip, grid
from operators.ports import Description, Run
from storage import Dataset, Session
from storage.layout import TABLE_OF, session_folders
from storage.writer import SessionWriter

STREAMS: list[tuple[type[Batch], int]] = [(Touch, 0), (Touch, 1), (Motion, -1), (Labelled, 0), (Slips, 0)]


def new_run(
    session: str = "one", describe: Mapping[str, Description] | None = None, *, live: bool = True
) -> Run:
    """A run of the flow `slip`, which began a minute ago."""
    start, clock = 1_700_000_000 * s + 5, EventClock(1_700_000_060 * s)
    return Run(session, "slip", clock, start, live=live, describe=dict(describe or {}))


def new_batch(
    kind: type[AnyBatch],
    rows: int = 5,
    *,
    start: int = 0,
    finger: int = 0,
    seed: int = 0,
    cells: int = BAROMETERS,
) -> AnyBatch:
    """Rows 10 ms apart whose other columns are random bits: every NaN and every extreme occurs."""
    random = np.random.default_rng(seed)
    values: list[Any] = [start + np.arange(rows) * 10 * ms]
    for column in list(columns(kind).values())[1:]:
        shape = (rows, *column.sizes(cells))
        if column.dtype == np.bool_:
            values.append(random.random(shape) < 0.5)
        elif column.names:
            values.append(random.integers(len(column.names), size=shape, dtype=np.int8))
        else:
            bits = random.bytes(int(np.prod(shape)) * column.dtype.itemsize)
            values.append(np.frombuffer(bits, column.dtype).reshape(shape).copy())
    return kind(*values, finger=EVERY if issubclass(kind, Motion | Episodes) else finger)


def new_episodes(*rows: tuple[int, int, str]) -> Episodes:
    """Return episodes with a start (ns), an end (ns) and a motion each, on a plane."""
    start, end = (np.array([row[k] for row in rows], np.int64) for k in (0, 1))
    motion = np.array([MOTIONS.index(row[2]) for row in rows], np.int8)
    zero, unknown = np.zeros(len(rows)), np.full(len(rows), np.nan)
    return Episodes(start, end, motion, np.zeros_like(motion), zero, zero, zero, unknown, unknown)


def new_samples(time: Sequence[int] | NDArray[Any], finger: int = 0) -> Labelled:
    """Return samples at given instants whose values are their position; the arm's motion is known."""
    row = np.arange(len(time))
    counts = np.arange(6) + 10 * row[:, None] + 1000 * finger
    wide = row[:, None] + np.arange(6) / 8
    label = row % 3 - 1
    return Labelled.rows(time, counts, -1, True, wide, np.nan, True, wide[:, 0], label, finger=finger)


def record(
    root: Path, batches: Sequence[Any], session: str = "one", split: str | None = None, part_rows: int = 20
) -> Session:
    """Write batches as a session of a dataset, in parts of some rows, and open it."""
    dataset = Dataset(root)
    dataset.part_rows = part_rows
    run_sink(dataset, new_run(session, {"touch": {"split": split}}), batches)
    return Session.open(root / "sessions" / session)


def run_sink(dataset: Dataset, run: Run, batches: Iterable[Any]) -> None:
    """Write batches to a dataset as a runner does."""

    async def main() -> None:
        await dataset.open(run)
        for batch in batches:
            await dataset.write(batch)
        await dataset.close()

    asyncio.run(main())


def write_pad(root: Path, fingers: Sequence[int] = (0,)) -> Session:
    """Write a session of 9 cells in steps of 0.01 kPa at 50 Hz: 2.4 s unloaded, 1.6 s at 7.47 kPa."""
    run, row = new_run(), np.arange(200)
    run.fingertips = {str(root): {Touch: Fingertip(grid(9), 50.0, "kPa", 0.01, (0, 4000))}}
    counts = np.where(row < 120, 20, 767).astype(np.int16)[:, None] + np.zeros(9, np.int16)
    values = run.start + row * 20 * ms, counts, np.zeros_like(counts), counts > 0
    write(root, run, [Touch(*values, finger=finger) for finger in fingers]).close()
    return Session.open(root)


def same(found: Batch, expected: Batch) -> None:
    """Assert that two batches have the same type, fingertip and rows, bit for bit, NaN included."""
    assert type(found) is type(expected)
    assert found.finger == expected.finger or not len(found)
    for name in columns(type(found)):
        one, other = getattr(found.check(), name), getattr(expected.check(), name)
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes()), name


def side_by_side(turns: int, streams: Sequence[tuple[type[Batch], int]] = STREAMS) -> list[Batch]:
    """Several streams, 5 rows and 50 ms at a time."""
    return [
        new_batch(kind, 5, start=turn * 50 * ms, finger=finger, seed=100 * turn + number)
        for turn in range(turns)
        for number, (kind, finger) in enumerate(streams)
    ]


def write(root: Path, run: Run, batches: Sequence[Batch]) -> SessionWriter:
    """Record: of 250 ms that is two parts of each table, and 5 rows (10 of two fingertips) in the journal."""
    writer = SessionWriter(root, run, part_span=100 * ms, part_rows=1000)
    for batch in batches:
        if writer.full(batch):
            writer.commit()
        if run.live:  # in the journal at once, so that its content does not depend on the journal's thread
            writer.append(batch)
        else:
            writer.add(batch)
    return writer


def leave(root: Path, run: Run, batches: Sequence[Batch]) -> Path:
    """The same, and be gone without closing the session."""
    return write(root, run, batches).folder


def rows(
    folder: Path, batches: Sequence[Batch], streams: Sequence[tuple[type[Batch], int]] = STREAMS
) -> list[int]:
    """Return the number of rows of each stream; assert that they are its beginning, bit for bit."""
    session, counts = Session.open(folder), list[int]()
    for kind, finger in streams:
        found = concat(kind, list(session.read(kind, finger)))
        written = concat(kind, [batch for batch in batches if type(batch) is kind and batch.finger == finger])
        for name in TABLE_OF[kind].columns:
            assert getattr(found, name).tobytes() == getattr(written, name)[: len(found)].tobytes()
        counts.append(len(found))
    return counts


def flip(path: Path, place: int, bit: int = 4) -> bytes:
    """Flip a bit of a file (the third of a byte by default); return the new content."""
    data = bytearray(path.read_bytes())
    data[place] ^= bit
    path.write_bytes(data)
    return bytes(data)


def session_names(root: Path) -> list[str]:
    return [folder.name for folder in session_folders(root)]


def contents(root: Path) -> dict[str, bytes]:
    """Return all files below a folder by their paths in it."""
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}
