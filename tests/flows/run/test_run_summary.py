import json

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
    assert (summary.seconds, summary.lost) == (10.0, False)
    assert summary.report().splitlines() == [
        "run1: 10.0 s",
        "  touch: 300 rows in, 2 late, 0 gaps",
        "  dataset: 12 rows out, 0 dropped",
        "  mqtt: 9 rows out, 0 dropped",
    ]
    assert json.loads(json.dumps(summary.as_dict()))["sources"]["touch"]["rows"] == 300


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


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("sink", "dropped", 1),
        ("sink", "error", "disk full"),
        ("source", "error", "bus stuck"),
        ("run", "error", "was interrupted"),
    ],
)
def test_a_loss_at_the_end_is_an_error_of_the_whole_run(
    ended: Run, part: str, name: str, value: object
) -> None:
    assert (Summary.of(ended).lost, Summary.of(ended).as_dict()["error"]) == (False, None)
    parts = {"sink": ended.sinks["dataset"], "source": ended.sources["touch"], "run": ended}
    setattr(parts[part], name, value)
    summary = Summary.of(ended)
    assert (summary.lost, summary.as_dict()["error"]) == (True, summary.error)
    assert summary.error
