from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from operators.batch import EVERY, Batch, Clocks, Motion, columns, ms, s
from operators.ports import Description, Run


class StoppedClock:
    def now(self) -> int:
        return 1_700_000_060 * s

    async def sleep_until(self, time: int) -> None:
        raise AssertionError(time)


@pytest.fixture(scope="session")
def new_run() -> Callable[..., Run]:
    def build(session: str = "one", describe: Mapping[str, Description] | None = None) -> Run:
        return Run(session, "slip", StoppedClock(), 1_700_000_000 * s + 5, describe=dict(describe or {}))

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
def alike() -> Callable[[Batch, Batch], None]:
    def compare(left: Batch, right: Batch) -> None:
        assert type(left) is type(right)
        assert left.finger == right.finger
        for each in columns(type(left)):
            one, other = getattr(left, each), getattr(right, each)
            assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())

    return compare
