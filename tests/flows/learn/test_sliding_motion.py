import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.sim.simulated_rig import SLIDING
from flows.learn.labelled_recordings import sliding_motion
from operators import Truth, ms
from operators.batch import Reals, Times

PERIOD = 10 * ms


def truth(sliding: Reals, start: int = 0, period: int = PERIOD) -> Truth:
    return Truth.rows(start + np.arange(len(sliding)) * period, sliding, 1.0, 0.0)


def speeds(rows: Truth) -> Reals:
    return sliding_motion(rows).velocity[:, 0]


def test_between_slip_and_rest_the_speed_is_unknown() -> None:
    sliding = np.zeros(100)
    sliding[50:53] = 0.01  # 0.3 mm: less than a slip, more than rest
    found = speeds(truth(sliding))
    assert np.isnan(found[52:75]).all()
    assert not np.isnan(found[:51]).any()
    assert found[80:].tolist() == [0] * 20


def test_nothing_slides_while_no_rows_come_and_a_late_row_counts_nothing() -> None:
    time = [*range(10), 100, 3, 101]
    found = sliding_motion(Truth.rows(np.array(time) * PERIOD, 0.05, 1.0, 0.0, finger=2))
    assert (found.time / PERIOD).tolist() == [*range(10), 100, 101]
    assert found.velocity[-2:, 0].tolist() == [0.0, pytest.approx(0.05 / 15)]
    assert found.finger == 2
    assert len(sliding_motion(Truth.empty())) == 0


def travelled(sliding: Reals, time: Times, row: int, span: int) -> float:
    """Add up what the contact has slid (m) in a span (ns) before a row."""
    return sum(
        float(sliding[each]) * int(time[each] - time[each - 1]) / 1e9
        for each in range(1, row + 1)
        if time[each] > time[row] - span
    )


@given(
    st.lists(st.sampled_from([0.0, 0.002, 0.004, 0.1]), min_size=30, max_size=60),
    st.sampled_from([ms // 5, ms, 7 * ms, PERIOD, 50 * ms]),
)
def test_the_speed_is_the_mean_over_150_ms_at_any_rate(values: list[float], period: int) -> None:
    sliding = np.repeat(values, max(PERIOD // period, 1))
    rows = truth(sliding, period=period)
    measured = speeds(rows)
    for row in range(0, len(rows), len(rows) // 9):
        travels = [travelled(sliding, rows.time, row, span * ms) for span in (150, 250)]
        mean, slow = travels[0] / 0.15, travels[1] / 0.25
        found = float(measured[row])
        if np.isnan(found):
            assert mean <= SLIDING + 1e-9
            assert slow > SLIDING / 3 - 1e-9
        else:
            assert found == pytest.approx(mean, abs=1e-9)
