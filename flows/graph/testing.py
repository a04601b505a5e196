"""Aids for testing flows, operators and connectors: a source, a sink and an event loop in virtual time."""

import asyncio
import selectors
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Sequence
from typing import Any, Generic, TypeVar

from operators.batch import EVERY, Batch, concat
from operators.ports import Clock, Run, Sink, Source

T = TypeVar("T")
B = TypeVar("B", bound=Batch)


class TestSource(Source[B], Generic[B]):
    """Gives the batches it was made with, each at its own time.

    An exception among them is raised where it stands, as a failing device would; what follows it is given
    when the runner connects again.
    """

    __test__ = False

    def __init__(
        self,
        kind: type[B],
        batches: Iterable[B | Exception] = (),
        *,
        fingers: tuple[int, ...] = (EVERY,),
        delay: int = 0,
    ) -> None:
        """Let each batch arrive `delay` ns after its newest row; the first row is at the start of the run."""
        self._kind, self._fingers, self._delay = kind, fingers, delay
        self._rest = list(batches)
        self._origin: tuple[int, int] | None = None  # first stamp and the clock's time then, ns

    @property
    def kind(self) -> type[B]:
        """The type of its batches."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """The fingertips that its batches belong to."""
        return self._fingers

    async def batches(self, clock: Clock) -> AsyncIterator[B]:
        """Give the rest, up to the next exception."""
        while self._rest:
            item = self._rest.pop(0)
            if isinstance(item, Exception):
                raise item
            if len(item):
                if self._origin is None:
                    self._origin = (int(item.time[0]), clock.now())
                first, began = self._origin
                await clock.sleep_until(began + int(item.time[-1]) - first + self._delay)
            yield item

    def __str__(self) -> str:
        return f"TestSource({self._kind.__name__})"


class TestSink(Sink[Batch]):
    """Keeps what it is given; can be made to fail, or to wait.

    Args:
        destination: what it claims to write to; of its own by default.
        lossless: whether the runner may drop when it falls behind.
        capacity: batches that may wait for it.
        failures: exceptions for its first writes, None for a write that works.
        hold: awaited before each write.
    """

    __test__ = False

    def __init__(
        self,
        destination: str = "",
        *,
        lossless: bool = True,
        capacity: int = 4096,
        failures: Sequence[Exception | None] = (),
        hold: Callable[[], Coroutine[Any, Any, None]] | None = None,
    ) -> None:
        self._destination = destination or f"test sink {id(self)}"
        self.lossless, self.capacity = lossless, capacity
        self._failures, self._hold = list(failures), hold
        self.written: list[Batch] = []
        self.opened = self.closed = 0

    @property
    def destination(self) -> str:
        """What it claims to write to."""
        return self._destination

    async def open(self, run: Run) -> None:
        """Count it."""
        self.run = run
        self.opened += 1

    async def write(self, batch: Batch) -> None:
        """Keep the batch, or fail as told."""
        if self._hold:
            await self._hold()
        if self._failures and (failure := self._failures.pop(0)):
            raise failure
        self.written.append(batch)

    async def close(self) -> None:
        """Count it."""
        self.closed += 1

    def rows(self, kind: type[B], finger: int = EVERY) -> B:
        """All rows of one type that were written for one fingertip."""
        return concat(kind, [b for b in self.written if isinstance(b, kind) and b.finger == finger])

    def __str__(self) -> str:
        return "TestSink()"


class _InstantSelector(selectors.DefaultSelector):
    """Instead of waiting it moves the loop's time on, unless something is ready."""

    time = 0.0  # s

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(None if timeout is None else 0)
        if not ready and timeout:
            self.time += timeout
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop in which sleeping takes no time: `time` jumps to when the next task is due."""

    def __init__(self) -> None:
        self._virtual = _InstantSelector()
        super().__init__(self._virtual)

    def time(self) -> float:
        """Virtual seconds since the loop was made."""
        return self._virtual.time

    def stall(self, seconds: float) -> None:
        """Let time pass in which nothing runs, as a busy host does."""
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
