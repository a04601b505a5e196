"""Interfaces between a flow and the outside world: `Source`, `Sink`, `Recording`, `Clock`, `Run`.

Connectors and storage implement them.
"""

from abc import ABC, abstractmethod
from collections.abc import AsyncGenerator, AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, Literal, Protocol, TypeAlias, TypeVar

from operators.batch import EVERY, Batch, s
from operators.fingertip import Fingertip

Given = TypeVar("Given", bound=Batch, covariant=True)
Taken = TypeVar("Taken", bound=Batch, contravariant=True)
SomeBatch = TypeVar("SomeBatch", bound=Batch)
Json: TypeAlias = "bool | int | float | str | Sequence[Json] | dict[str, Json] | None"
Description: TypeAlias = Mapping[str, Json]


class Clock(Protocol):
    """Monotonic clock of a run; virtual in tests and replays."""

    def now(self) -> int:
        """Return the current time, ns since 1970-01-01 UTC."""
        ...

    async def sleep_until(self, time: int) -> None:
        """Wait until `time` (ns); return at once if it has passed."""
        ...


@dataclass(frozen=True)
class Gap:
    """Period without rows while a source was failing."""

    start: int  # ns, the last row before the failure
    end: int  # ns, when the source worked again
    reason: str


@dataclass(frozen=True)
class ClockStep:
    """Step of the host's clock during a run; the run's own time is not affected."""

    time: int  # ns, run time at which the step was detected
    offset: int  # ns, host clock minus run time after the step


@dataclass
class SourceStatus:
    """Counters and state of one source during a run."""

    rows: int = 0
    late: int = 0  # rows older than a row before them, or of the future
    missing: int = 0  # rows that should have come in pauses, at the declared rate
    declared_rate: float | None = None  # rows per second, of all fingertips; None: unknown
    newest: int = 0  # ns, event time of the newest row
    up: bool = False
    stale: bool = False  # delivers no rows in time although it has not failed; `error` says for how long
    failures: int = 0  # the source is restarted after each
    error: str = ""  # latest failure or silence; empty while the source works
    gaps: list[Gap] = field(default_factory=list[Gap])

    @property
    def lost(self) -> int:
        """Rows that are missing or late."""
        return self.missing + self.late


@dataclass
class SinkStatus:
    """Counters and state of one sink during a run."""

    rows: int = 0
    queued: int = 0  # batches
    waiting: int | None = None  # copy of `Sink.waiting`
    unstored: int = 0  # copy of `Sink.pending`, once per second; at the end they count as dropped
    connected: bool | None = None  # copy of `Sink.connected`, once per second
    dropped: int = 0  # rows lost by policy, or while the sink failed
    failures: int = 0
    error: str = ""  # latest failure; empty while the sink works
    records: bool = False  # copy of `Sink.records`


@dataclass
class Run:
    """State of one execution of a flow, shared with its sinks."""

    session: str  # identifier, valid as a file name
    flow: str
    clock: Clock
    start: int  # ns
    live: bool = True  # False: a replay at full speed, whose clock follows event time
    recording: str | None = None  # name of the replayed recording; None: the rows are new
    error: str = ""  # reason of an early end; empty: none
    declaration: tuple[str, ...] = ()  # definition of each stream, one line each
    describe: dict[str, Description] = field(default_factory=dict[str, Description])  # by source
    sources: dict[str, SourceStatus] = field(default_factory=dict[str, SourceStatus])
    sinks: dict[str, SinkStatus] = field(default_factory=dict[str, SinkStatus])
    sink_types: dict[str, dict[type[Batch], tuple[int, ...]]] = field(
        default_factory=dict[str, dict[type[Batch], tuple[int, ...]]]
    )  # by destination: types that it can receive, and their fingertips
    fingertips: dict[str, dict[type[Batch], Fingertip]] = field(  # by destination and type, if known
        default_factory=dict[str, dict[type[Batch], Fingertip]]
    )
    clock_steps: list[ClockStep] = field(default_factory=list[ClockStep])

    def latency(self, time: int) -> int | None:
        """Return the age (ns) of a sample with stamp `time` (ns); None in a replay."""
        return self.clock.now() - time if self.live and self.recording is None else None


@dataclass(frozen=True)
class Finding:
    """Result of one check before a run, as `slipflow doctor` prints it."""

    subject: str  # what was checked, such as a bus, an address or a folder
    text: str  # what was found, and unless it is good how to fix it
    state: Literal["good", "note", "bad"] = "good"  # note: a run works, but may lack something


class Endpoint:
    """Source or sink: connection of a flow to the outside."""

    extra: str = ""  # extra of slipflow that it needs

    async def diagnose(self, clock: Clock) -> AsyncGenerator[Finding]:
        """Check devices, servers and files as a run would use them, without moving or changing anything.

        `slipflow doctor` reports an exception as a bad finding; its message should say how to fix the cause.
        """
        for finding in tuple[Finding, ...]():
            yield finding


class Source(Endpoint, ABC, Generic[Given]):
    """Input stream of a flow.

    A source without a row for `stale_after` counts as failed until its next row; late rows do not count.
    """

    stale_after: int | None = 5 * s  # ns; None: rows may be rare or missing
    in_run_time: bool = True  # stamps are of the clock of the run; False: of another time

    @property
    @abstractmethod
    def kind(self) -> type[Given]:
        """Type of the batches."""

    @property
    def exact_kind(self) -> type[Batch]:
        """Type of the batches in a run: `kind`, or a subtype that only the run can know."""
        return self.kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """Fingertips that the batches belong to."""
        return (EVERY,)

    @property
    def fingertip(self) -> Fingertip | None:
        """Cells, layout, rate, unit and range of its fingertips; None: unknown, or not a touch stream."""
        return None

    def prepare(self) -> None:
        """Do slow set-up, such as compilation, before a run and in `check`; open no device."""
        return

    @abstractmethod
    def batches(self, clock: Clock) -> AsyncIterator[Given]:
        """Connect and yield batches, each of one fingertip, stamped in the clock's time.

        A return ends the stream. An exception is a failure of the device: the runner records a gap and calls
        this method again after a back-off. Three failures end the run, because a retry would not help: a
        batch of the wrong type or shape, a `SlipflowError` other than `EndpointError`, and an error that
        Python raises for mistakes in the code, such as KeyError, TypeError or ValueError. If a device causes
        such an error, for example by a malformed line, raise an `EndpointError` instead.
        """

    @property
    def recording(self) -> str | None:
        """Name of the recording that the rows come from; None: they are new."""
        return None

    def describe(self) -> Description:
        """Return the metadata to record with the stream: sensor, bus, seed."""
        return {}


class Sink(Endpoint, ABC, Generic[Taken]):
    """Output of a flow, which implements `take`, `write` or both.

    The runner calls `open` once, `take` or `write` for each batch, and `close` once. A batch that `take` does
    not accept waits in a bounded queue for `write`, and so do those after it. If `write` raises, the runner
    retries the same batch after a back-off, unless the error is a mistake in the code, such as KeyError or
    TypeError: that ends the run. An `OutputClosedError` ends the run in an orderly way.
    """

    lossless: bool = True  # False: when the queue is full, the oldest batch is dropped and counted
    capacity: int = 4096  # batches in the queue
    shared: bool = False  # True: several processes may write to the destination at once, each in its own run
    records: bool = False  # True: stores the run's rows, so dropped rows are lost; status displays warn
    live_only: bool = False  # True: a replay is an error, as old rows would move hardware or look new

    @property
    @abstractmethod
    def destination(self) -> str:
        """Path or address that the sink writes to; unique in a flow."""

    @property
    def pending(self) -> int:
        """Accepted rows that are not stored yet and would be lost if `close` did not complete."""
        return 0

    @property
    def waiting(self) -> int | None:
        """Stored events that the receiver has not acknowledged; None: nothing is acknowledged."""
        return None

    @property
    def connected(self) -> bool | None:
        """True while the receiver can be reached and refuses nothing; None: there is no receiver."""
        return None

    @abstractmethod
    async def open(self, run: Run) -> None:
        """Prepare for writing. An exception ends the run before it starts."""

    def take(self, batch: Taken) -> bool:
        """Write one batch without waiting, or return False to get it through `write`; same exceptions.

        Sinks that never wait implement only this. It saves a queue and a switch of tasks. A subclass that
        changes `write` of a sink with `take` changes both.
        """
        return False

    async def write(self, batch: Taken) -> None:
        """Write one batch. An exception means that no row of it was written."""
        if not self.take(batch):
            raise NotImplementedError(
                f"{type(self).__name__} must implement `write`, as its `take` returned False"
            )

    async def close(self) -> None:
        """Complete and release the destination."""
        return


class Recording(Protocol):
    """Recorded streams that can be replayed."""

    @property
    def name(self) -> str:
        """Name for messages."""
        ...

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """Return the fingertips that have rows of `kind`; () if there is no such stream."""
        ...

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        """Yield the stream in batches of at most `rows`; may yield a subtype, as Zeroed for Touch."""
        ...

    def describe(self) -> Description:
        """Return the metadata of the recording."""
        ...

    def fingertip(self, kind: type[Batch]) -> Fingertip | None:
        """Return the fingertip of the touch stream `kind`; None: unknown, or no such stream."""
        ...


@dataclass
class BackOff:
    """Delays that double with each failure, from 0.1 s to 5 s.

    >>> retry = BackOff()
    >>> [retry.delay() for _ in range(8)]
    [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0]
    >>> retry.reset()
    >>> retry.delay()
    0.1
    """

    _next: float = field(default=0.1, init=False, repr=False)

    def delay(self) -> float:
        """Return the delay (s) before the next attempt, and double the one after it."""
        delay, self._next = self._next, min(2 * self._next, 5.0)
        return delay

    def reset(self) -> None:
        """Restart at 0.1 s, after a success."""
        self._next = 0.1
