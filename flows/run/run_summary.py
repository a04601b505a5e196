"""Summary of a run, as text and as JSON."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

from operators.batch import s
from operators.ports import Run, SinkStatus, SourceStatus


@dataclass(frozen=True)
class Summary:
    """Counters of a finished run; unlike `Run` it can be pickled."""

    session: str
    flow: str
    seconds: float  # run time
    sources: Mapping[str, SourceStatus]  # by name
    sinks: Mapping[str, SinkStatus]  # by name
    error: str = ""  # reason of an early end; empty: none

    @classmethod
    def of(cls, run: Run) -> Self:
        """Return the summary of a run."""
        seconds = (run.clock.now() - run.start) / s
        return cls(run.session, run.flow, seconds, dict(run.sources), dict(run.sinks), run.error)

    @property
    def rows_in(self) -> int:
        """Rows of all sources."""
        return sum(source.rows for source in self.sources.values())

    @property
    def lost(self) -> bool:
        """True if a source was down or silent at the end, or a sink dropped rows."""
        return any(sink.dropped or sink.error for sink in self.sinks.values()) or any(
            source.error for source in self.sources.values()
        )

    def as_dict(self) -> dict[str, Any]:
        """Return all fields, for JSON."""
        return {**asdict(self), "error": self.error or None}

    def report(self) -> str:
        """Return the summary as text."""
        lines = [f"{self.session}: {self.seconds:.1f} s"]
        for name, source in self.sources.items():
            gaps = f"{len(source.gaps)} {'gap' if len(source.gaps) == 1 else 'gaps'}"
            gaps += f": {source.error}" if source.error else ""
            lines.append(f"  {name}: {source.rows} rows in, {source.late} late, {gaps}")
        for name, sink in self.sinks.items():
            error = f": {sink.error}" if sink.error else ""
            lines.append(f"  {name}: {sink.rows} rows out, {sink.dropped} dropped{error}")
        return "\n".join(lines)
