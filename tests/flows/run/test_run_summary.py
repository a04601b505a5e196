import json
from collections.abc import Callable

import pytest

from flows.run.run_summary import Summary
from operators import Run
from operators.ports import Gap, SinkStatus, SourceStatus


@pytest.fixture
def ended(run: Run) -> Run:
    run.sources["touch"] = SourceStatus(rows=300, late=2)
    run.sinks["dataset"] = SinkStatus(rows=12)
    return run


def test_the_summary_counts_rows_in_and_out(ended: Run) -> None:
    summary = Summary.of(ended)
    assert (summary.seconds, summary.rows_in, summary.lost) == (10.0, 300, False)
    assert summary.report().splitlines() == [
        "run1: 10.0 s",
        "  touch: 300 rows in, 2 late, 0 gaps",
        "  dataset: 12 rows out, 0 dropped",
    ]
    assert json.loads(json.dumps(summary.as_dict()))["sources"]["touch"]["rows"] == 300


def test_the_summary_gives_the_errors_of_sources_and_sinks(ended: Run) -> None:
    ended.sources["touch"].error = "bus stuck"
    ended.sources["touch"].gaps.append(Gap(start=1, end=2, reason="bus stuck"))
    ended.sinks["dataset"].error = "disk full"
    assert Summary.of(ended).report().splitlines()[1:] == [
        "  touch: 300 rows in, 2 late, 1 gap: bus stuck",
        "  dataset: 12 rows out, 0 dropped: disk full",
    ]


def dropped(run: Run) -> None:
    run.sinks["dataset"].dropped = 1


def failed(run: Run) -> None:
    run.sources["touch"].error = "bus stuck"


def full(run: Run) -> None:
    run.sinks["dataset"].error = "disk full"


@pytest.mark.parametrize("spoil", [dropped, failed, full])
def test_rows_that_were_dropped_and_ends_that_are_down_are_losses(
    ended: Run, spoil: Callable[[Run], None]
) -> None:
    spoil(ended)
    assert Summary.of(ended).lost
