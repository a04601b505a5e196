from dataclasses import replace

import pytest

from operators.batch import ms
from operators.ports import Run


def test_a_sample_of_a_live_run_has_a_latency(run: Run) -> None:
    assert run.latency(run.clock.now() - 3 * ms) == 3 * ms


@pytest.mark.parametrize("live", [True, False])
def test_replayed_rows_have_no_latency(run: Run, *, live: bool) -> None:
    replay = replace(run, recording="stroke-9", live=live)
    assert replay.latency(run.clock.now() - 3 * ms) is None
