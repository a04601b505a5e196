"""The ends of a flow: what a connector must offer to feed it or to take what it gives.

Only the shapes stand here; what talks to the world lives in connectors and storage.
"""

from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeAlias, TypeVar

from operators.batch import EVERY, Batch

Given = TypeVar("Given", bound=Batch, covariant=True)
Taken = TypeVar("Taken", bound=Batch, contravariant=True)
SomeBatch = TypeVar("SomeBatch", bound=Batch)
Json: TypeAlias = "bool | int | float | str | Sequence[Json] | dict[str, Json] | None"
Description: TypeAlias = Mapping[str, Json]


class Clock(Protocol):
    """Time as a run sees it: never steps back, and in tests need not pass."""

    def now(self) -> int:
        """The present, ns since 1970-01-01 UTC."""
        ...

    async def sleep_until(self, time: int) -> None:
        """Wait until `time` (ns); at once if it has passed."""
        ...


@dataclass(frozen=True)
class Gap:
    """A span in which a source gave nothing because it had failed."""

    start: int  # ns, the last row before it
    end: int  # ns, when the source was up again
    reason: str


@dataclass(frozen=True)
class ClockStep:
    """The host's clock was set during a run, whose time goes on as before."""

    time: int  # ns, of the run, when it was noticed
    offset: int  # ns, the host's clock minus the run's since then


@dataclass
class SourceStatus:
    """What a run knows of one source."""

    rows: int = 0
    late: int = 0  # rows that came after newer ones
    newest: int = 0  # ns, event time of the newest row
    up: bool = False
    failures: int = 0  # after each it is started again
    error: str = ""  # the newest failure; empty while it works
    gaps: list[Gap] = field(default_factory=list[Gap])


@dataclass
class SinkStatus:
    """What a run knows of one sink."""

    rows: int = 0
    queued: int = 0  # batches
    dropped: int = 0  # rows that were given up, by policy or because the sink had failed
    failures: int = 0
    error: str = ""  # the newest failure; empty while it works
    records: bool = False  # what it drops is missing in what is recorded of the run


@dataclass
class Run:
    """One execution of a flow, shown to its sinks while it lasts."""

    session: str  # identifier, a file name
    flow: str
    clock: Clock
    start: int  # ns
    live: bool = True  # False: a replay at full speed, whose clock tells event time
    recording: str | None = None  # the name of what is replayed, paced or not; None: its rows are new
    error: str = ""  # why it ended early; empty: it did not
    declaration: tuple[str, ...] = ()  # how the streams come about, a line each
    describe: dict[str, Description] = field(default_factory=dict[str, Description])  # by source
    sources: dict[str, SourceStatus] = field(default_factory=dict[str, SourceStatus])
    sinks: dict[str, SinkStatus] = field(default_factory=dict[str, SinkStatus])
    wired: dict[str, tuple[type[Batch], ...]] = field(  # by a sink's place: what it may be given
        default_factory=dict[str, tuple[type[Batch], ...]]
    )
    clock_steps: list[ClockStep] = field(default_factory=list[ClockStep])

    def latency(self, time: int) -> int | None:
        """How long ago (ns) a sample was taken that has `time` (ns); None in a replay: it is an old one."""
        return self.clock.now() - time if self.live and self.recording is None else None


class Source(ABC, Generic[Given]):
    """A stream from the world."""

    @property
    @abstractmethod
    def kind(self) -> type[Given]:
        """The type of the batches it gives."""

    @property
    def fingers(self) -> tuple[int, ...]:
        """The fingertips that its batches belong to."""
        return (EVERY,)

    async def prepare(self) -> None:
        """Do what takes long before the run's time begins, without holding up the event loop."""
        return

    @abstractmethod
    def batches(self, clock: Clock) -> AsyncIterator[Given]:
        """One connection's worth of batches, each of one fingertip, stamped in the clock's time.

        Ending means that the stream is complete. Raising means that the source failed: the runner records
        a gap and calls again, with back-off.
        """

    @property
    def recording(self) -> str | None:
        """The name of the recording that its rows are from; None: they are new."""
        return None

    def describe(self) -> Description:
        """What a recording should say of this source: sensor, rate, bus, seed."""
        return {}


class Sink(ABC, Generic[Taken]):
    """Something that takes batches out of a flow.

    The runner gives each sink a bounded queue of its own, calls `open` once, `write` one batch at a time and
    `close` once. When `write` raises, the runner calls it again with the same batch, after a back-off.
    """

    lossless: bool = True  # False: when the queue is full the oldest batch is dropped and counted
    capacity: int = 4096  # batches
    shared: bool = False  # True: several processes may write to its place at once, each a run of its own
    records: bool = False  # True: it keeps the rows of a run; what it drops is missing for good

    @property
    @abstractmethod
    def place(self) -> str:
        """What it writes to, such as a path or an address: two sinks of a flow may not share it."""

    @property
    def replay_place(self) -> str:
        """What it writes to in a replay: elsewhere, if what is old could be taken for new at its place."""
        return self.place

    @abstractmethod
    async def open(self, run: Run) -> None:
        """Get ready to write. Raising ends the run before it starts.

        What moves something must refuse a run that has a `recording`.
        """

    @abstractmethod
    async def write(self, batch: Taken) -> None:
        """Write one batch. Raising means that nothing of it was written."""

    async def close(self) -> None:
        """Complete what was written."""
        return


class Recording(Protocol):
    """Something recorded that a flow can be run over again."""

    @property
    def name(self) -> str:
        """What it is called in messages."""
        ...

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """The fingertips it holds rows of `kind` for; () where it holds no such stream."""
        ...

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        """The stream in batches of at most `rows`; a subtype may be given, as Zeroed for Touch."""
        ...

    def describe(self) -> Description:
        """What the recording says of itself."""
        ...
