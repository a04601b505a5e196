import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.batch import EVERY, Batch, Clocks, Labelled, Motion, columns, ms, s
from operators.ports import Description, Json, Run
from storage import Dataset, Session


class StoppedClock:
    def now(self) -> int:
        return 1_700_000_060 * s

    async def sleep_until(self, time: int) -> None:
        raise AssertionError(time)


@pytest.fixture(scope="session")
def new_run() -> Callable[..., Run]:
    def build(
        session: str = "one", describe: Mapping[str, Description] | None = None, *, live: bool = True
    ) -> Run:
        clock, start = StoppedClock(), 1_700_000_000 * s + 5
        return Run(session, "slip", clock, start, live=live, describe=dict(describe or {}))

    return build


@pytest.fixture(scope="session")
def new_batch() -> Callable[..., Any]:
    """Rows 10 ms apart whose other columns are random bits: every NaN and every extreme occurs."""

    def build(kind: type[Batch], rows: int = 5, *, start: int = 0, finger: int = 0, seed: int = 0) -> Batch:
        random = np.random.default_rng(seed)
        values: list[Any] = [start + np.arange(rows) * 10 * ms]
        for column in list(columns(kind).values())[1:]:
            shape = (rows, *column.shape)
            if column.dtype == np.bool_:
                values.append(random.random(shape) < 0.5)
            else:
                bits = random.bytes(int(np.prod(shape)) * column.dtype.itemsize)
                values.append(np.frombuffer(bits, column.dtype).reshape(shape).copy())
        return kind(*values, finger=EVERY if kind in (Motion, Clocks) else finger)

    return build


@pytest.fixture(scope="session")
def record(new_run: Callable[..., Run]) -> Callable[..., Session]:
    """Write batches as a session of a dataset, in parts of 20 rows, and open it."""

    def build(
        root: Path, batches: Sequence[Any], session: str = "one", episodes: Sequence[Json] = ()
    ) -> Session:
        async def main() -> None:
            sink = Dataset(root, part_rows=20)
            await sink.open(new_run(session, {"touch": {"episodes": list(episodes)}}))
            for batch in batches:
                await sink.write(batch)
            await sink.close()

        asyncio.run(main())
        return Session.open(root / "sessions" / session)

    return build


@pytest.fixture(scope="session")
def new_samples() -> Callable[..., Labelled]:
    """Samples at given instants whose values tell their place; the arm's motion is known."""

    def build(time: Sequence[int] | NDArray[Any], finger: int = 0) -> Labelled:
        row = np.arange(len(time))
        counts = (np.arange(6) + 10 * row[:, None] + 1000 * finger).astype(np.int16)
        wide = row[:, None] + np.arange(6) / 8
        there = np.ones(len(time), np.bool_)
        return Labelled(
            np.asarray(time, np.int64),
            counts,
            np.full_like(counts, -1),
            np.ones(counts.shape, np.bool_),
            wide,
            np.full((len(time), 6), np.nan),
            there,
            wide[:, 0],
            (row % 3 - 1).astype(np.int8),
            finger=finger,
        )

    return build


@pytest.fixture(scope="session")
def alike() -> Callable[[Batch, Batch], None]:
    def compare(left: Batch, right: Batch) -> None:
        assert type(left) is type(right)
        assert left.finger == right.finger
        for each in columns(type(left)):
            one, other = getattr(left, each), getattr(right, each)
            assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())

    return compare
