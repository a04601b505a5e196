"""Summary of a run."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Self

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
    error: str = ""  # reason of an early end, or what was lost; empty: neither

    @classmethod
    def of(cls, run: Run) -> Self:
        """Return the summary of a run."""
        seconds, error = (run.clock.now() - run.start) / s, run.error or "; ".join(losses(run))
        return cls(run.session, run.flow, seconds, dict(run.sources), dict(run.sinks), error)

    def report(self) -> str:
        """Return the summary as text."""
        lines = [f"{self.session}: {self.seconds:.1f} s" + (f"; {self.error}" if self.error else "")]
        for name, source in self.sources.items():
            gaps = f"{len(source.gaps)} {'gap' if len(source.gaps) == 1 else 'gaps'}"
            missing = f"{source.missing} missing, " if source.missing else ""
            lines.append(f"  {name}: {source.rows} rows in, {source.late} late, {missing}{gaps}")
        for name, sink in self.sinks.items():
            waiting = f", {sink.waiting} not acknowledged (in the outbox)" if sink.waiting else ""
            lines.append(f"  {name}: {sink.rows} rows out, {sink.dropped} dropped{waiting}")
        return "\n".join(lines)


def losses(run: Run) -> Iterator[str]:
    """Yield what a run lost: sources that failed at the end or had mostly late rows, and dropped rows."""
    for name, source in run.sources.items():
        if source.error:
            yield f"{name}: {source.error}"
        if source.late > source.rows / 2:
            yield f"{name}: {source.late:,} of {source.rows:,} rows were late, so operators ignored them"
    for name, sink in run.sinks.items():
        if sink.dropped:
            yield f"{name} dropped rows ({sink.dropped:,})" + (f": {sink.error}" if sink.error else "")
        elif sink.error:
            yield f"{name}: {sink.error}"
