"""Testing of operators and flows: a check of cuts, source, sink, recording, and a loop in virtual time."""

import asyncio
import selectors
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Iterator
from concurrent.futures import Executor
from typing import Any, Generic, TypeVar, TypeVarTuple, Unpack

import numpy as np

from operators.batch import EVERY, Batch, Touch, columns, concat
from operators.fingertip import Fingertip
from operators.operator import Operator, output_type
from operators.ports import Clock, Description, Run, Sink, SomeBatch, Source

T = TypeVar("T")
B = TypeVar("B", bound=Batch)
Arguments = TypeVarTuple("Arguments")


def check_cuts(operator: Operator[Any, Any], batch: Batch) -> None:
    """Assert that an operator's output is the same for a batch row by row, in pieces and at once."""
    outputs = list[Batch]()
    for rows in (1, 7, max(len(batch), 1)):
        step = operator.reset_copy()
        pieces = [step.push(batch[start : start + rows]) for start in range(0, len(batch), rows)]
        pieces.append(step.flush())
        kind = next((type(each) for each in pieces if len(each)), output_type(type(operator)))
        outputs.append(concat(kind, pieces))
    for cut in outputs[:-1]:
        check_same(cut, outputs[-1])


def check_same(found: Batch, expected: Batch) -> None:
    """Assert that two batches have the same type, fingertip and rows, bit for bit; NaN equals NaN."""
    assert type(found.check()) is type(expected.check())
    assert len(found) == len(expected)
    assert found.finger == expected.finger or not len(found)
    for name in columns(type(found)):
        left, right = getattr(found, name), getattr(expected, name)
        np.testing.assert_array_equal(left, right, err_msg=name)
        if left.dtype.kind == "f":  # 0.0 and -0.0 are equal, but not the same
            known = ~np.isnan(left)
            np.testing.assert_array_equal(np.signbit(left)[known], np.signbit(right)[known], err_msg=name)


class TestSource(Source[B], Generic[B]):
    """Source of given batches, each at its own time.

    An exception among the batches is raised at its position, like the failure of a device. The batches after
    it follow when the runner reconnects.

    Args:
        kind: Type of the batches.
        batches: Batches and exceptions, in order; the first row is at the start of the run.
        fingers: Fingertips of the batches.
    """

    __test__ = False
    in_run_time = False

    def __init__(
        self, kind: type[B], batches: Iterable[B | Exception] = (), *, fingers: tuple[int, ...] = (EVERY,)
    ) -> None:
        self._kind, self._fingers = kind, fingers
        self._rest = list(batches)
        self._origin: tuple[int, int] | None = None  # first stamp and the clock's time then, ns

    @property
    def kind(self) -> type[B]:
        """Type of the batches."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """Fingertips that the batches belong to."""
        return self._fingers

    async def batches(self, clock: Clock) -> AsyncIterator[B]:
        """Yield the remaining batches, up to the next exception."""
        while self._rest:
            item = self._rest.pop(0)
            if isinstance(item, Exception):
                raise item
            if len(item):
                if self._origin is None:
                    self._origin = (int(item.time[0]), clock.now())
                first, began = self._origin
                await clock.sleep_until(began + int(item.time[-1]) - first)
            yield item

    def __str__(self) -> str:
        return f"TestSource({self._kind.__name__})"


class TestSink(Sink[Batch]):
    """Sink that keeps the batches.

    Args:
        destination: Declared destination; unique by default.
    """

    __test__ = False

    def __init__(self, destination: str = "") -> None:
        self._destination = destination or f"test sink {id(self)}"
        self.written: list[Batch] = []
        self.opened = self.closed = 0

    @property
    def destination(self) -> str:
        """Declared destination."""
        return self._destination

    async def open(self, run: Run) -> None:
        """Count the call."""
        self.run = run
        self.opened += 1

    def take(self, batch: Batch) -> bool:
        """Keep the batch."""
        self.written.append(batch)
        return True

    async def close(self) -> None:
        """Count the call."""
        self.closed += 1

    def rows(self, kind: type[B], finger: int = EVERY) -> B:
        """Return all written rows of one type and fingertip."""
        return concat(kind, [b for b in self.written if isinstance(b, kind) and b.finger == finger])

    def __str__(self) -> str:
        return "TestSink()"


class TestRecording:
    """Recording of given batches, one for each stream and fingertip.

    Args:
        name: Name of the recording.
        batches: All rows.
        fingertip: Fingertip of the touch; None: unknown.
    """

    __test__ = False

    def __init__(self, name: str, batches: Iterable[Batch], fingertip: Fingertip | None = None) -> None:
        self.name, self._batches, self._fingertip = name, list(batches), fingertip

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """Return the fingertips of the batches of a type."""
        return tuple(batch.finger for batch in self._batches if isinstance(batch, kind))

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        """Yield the batches of a type and fingertip, cut into pieces."""
        for batch in self._batches:
            if isinstance(batch, kind) and batch.finger == finger:
                for start in range(0, len(batch), rows):
                    yield batch[start : start + rows]

    def fingertip(self, kind: type[Batch]) -> Fingertip | None:
        """Return the fingertip of a stream of touch."""
        return self._fingertip if issubclass(kind, Touch) else None

    def describe(self) -> Description:
        """Return {}."""
        return {}


class _InstantSelector(selectors.DefaultSelector):
    """Selector that advances the loop's time instead of waiting."""

    time = 0.0  # s
    threads = 0  # calls in progress

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(None if timeout is None or (timeout and self.threads) else 0)
        if not ready and timeout:
            self.time += timeout
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """Event loop in virtual time: sleeping jumps to the time of the next task.

    Calls in threads take no virtual time.
    """

    def __init__(self) -> None:
        self._virtual = _InstantSelector()
        super().__init__(self._virtual)

    def time(self) -> float:
        """Return the virtual time since the loop was created, s."""
        return self._virtual.time

    def run_in_executor(
        self, executor: Executor | None, func: Callable[[Unpack[Arguments]], T], *args: *Arguments
    ) -> asyncio.Future[T]:
        """Call a function in a thread."""
        call = super().run_in_executor(executor, func, *args)
        self._virtual.threads += 1
        call.add_done_callback(self._end_call)
        return call

    def _end_call(self, _: asyncio.Future[Any]) -> None:
        self._virtual.threads -= 1

    def stall(self, seconds: float) -> None:
        """Advance time without running anything, as on a busy host."""
        self._virtual.time += seconds


def run_virtually(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to its end in virtual time.

    >>> async def wait_an_hour() -> float:
    ...     await asyncio.sleep(3600)
    ...     return asyncio.get_running_loop().time()
    >>> run_virtually(wait_an_hour())
    3600.0
    """
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(main)
