"""What a run came to, for a person and for a program."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

from operators.batch import s
from operators.ports import Run, SinkStatus, SourceStatus


@dataclass(frozen=True)
class Summary:
    """A run that has ended; unlike the run itself it travels between processes."""

    session: str
    flow: str
    seconds: float  # of the run's time
    sources: Mapping[str, SourceStatus]  # by name
    sinks: Mapping[str, SinkStatus]  # by name
    error: str = ""  # why it ended early; empty: it did not

    @classmethod
    def of(cls, run: Run) -> Self:
        """What a run came to."""
        seconds = (run.clock.now() - run.start) / s
        return cls(run.session, run.flow, seconds, dict(run.sources), dict(run.sinks), run.error)

    @property
    def taken(self) -> int:
        """The rows that its sources gave."""
        return sum(source.rows for source in self.sources.values())

    @property
    def given(self) -> int:
        """The rows that its sinks took."""
        return sum(sink.rows for sink in self.sinks.values())

    @property
    def lost(self) -> bool:
        """Whether a source was down at the end, or a sink lost rows."""
        return any(sink.dropped or sink.error for sink in self.sinks.values()) or any(
            source.error for source in self.sources.values()
        )

    def as_dict(self) -> dict[str, Any]:
        """All of it, for a program."""
        return {**asdict(self), "error": self.error or None}

    def report(self) -> str:
        """The same for a person."""
        lines = [f"{self.session}: {self.seconds:.1f} s"]
        for name, source in self.sources.items():
            gaps = f"{len(source.gaps)} gaps {source.error}".rstrip()
            lines.append(f"  {name}: {source.rows} rows in, {source.late} late, {gaps}")
        for name, sink in self.sinks.items():
            lines.append(f"  {name}: {sink.rows} rows out, {sink.dropped} dropped {sink.error}".rstrip())
        return "\n".join(lines)
