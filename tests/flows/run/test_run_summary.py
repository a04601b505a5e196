import pytest

from flows.run.run_summary import Summary
from operators import Run
from operators.ports import Gap, SinkStatus, SourceStatus


@pytest.fixture
def ended(run: Run) -> Run:
    run.sources["touch"] = SourceStatus(rows=300, late=2)
    run.sinks["dataset"] = SinkStatus(rows=12)
    run.sinks["mqtt"] = SinkStatus(rows=9, waiting=0)
    return run


def test_the_summary_counts_rows_in_and_out(ended: Run) -> None:
    summary = Summary.of(ended)
    assert (summary.seconds, summary.error) == (10.0, "")
    assert summary.report().splitlines() == [
        "run1: 10.0 s",
        "  touch: 300 rows in, 2 late, 0 gaps",
        "  dataset: 12 rows out, 0 dropped",
        "  mqtt: 9 rows out, 0 dropped",
    ]


def test_the_summary_gives_the_errors_of_sources_and_sinks(ended: Run) -> None:
    ended.sources["touch"].error = "bus stuck"
    ended.sources["touch"].gaps.append(Gap(start=1, end=2, reason="bus stuck"))
    ended.sinks["dataset"].error, ended.sinks["dataset"].dropped = "disk full", 1617
    ended.sinks["mqtt"].waiting = 9
    summary = Summary.of(ended)
    assert summary.error == "touch: bus stuck; dataset dropped rows (1,617): disk full"
    assert summary.report().splitlines() == [
        f"run1: 10.0 s; {summary.error}",
        "  touch: 300 rows in, 2 late, 1 gap",
        "  dataset: 12 rows out, 1617 dropped",
        "  mqtt: 9 rows out, 0 dropped, 9 not acknowledged (in the outbox)",
    ]
