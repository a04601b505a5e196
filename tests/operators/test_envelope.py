import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators import ParameterError, ms, s
from operators.envelope import BLOCKS, EPOCH, PAUSE, SLOPE, envelope, host_time, line, starts_epoch


class _Clock:
    def __init__(self, window: int = 6 * s, drift: float = 1e-3, jump: int = 100 * ms) -> None:
        self.state = envelope("DeviceClock", window, drift, jump)

    def host_time(self, device: int, arrival: int) -> int:
        return host_time(device, arrival, self.state)

    def starts_epoch(self, device: int, arrival: int) -> bool:
        return bool(starts_epoch(device, arrival, self.state))


@given(
    rows=st.lists(st.tuples(st.integers(0, 1000), st.integers(-50, 50)), min_size=1, max_size=40),
    limit=st.sampled_from([0.0, 0.01, 10.0]),
)
def test_the_line_lies_under_all_rows_and_no_other_lies_higher_in_their_mean(
    rows: list[tuple[int, int]], limit: float
) -> None:
    x, y = np.array(sorted(rows), np.float64).T
    x *= s
    offset, drift = line(x, y, limit)
    assert abs(drift) <= limit
    above = y - offset - drift * x
    assert above.min() == pytest.approx(0, abs=1e-6)
    covered = x[-1] - x[0] >= 5 * s
    if not covered:
        assert drift == 0
        return
    slopes = {
        (y[j] - y[i]) / (x[j] - x[i]) for i in range(len(x)) for j in range(i) if x[i] > x[j]
    }  # of the hull's edges, among others
    for other in {-limit, limit, *(each for each in slopes if abs(each) <= limit)}:
        best = (y - other * x).min() + other * x.mean()
        assert offset + drift * x.mean() >= best - 1e-6


def test_the_first_row_comes_when_it_came() -> None:
    assert _Clock().host_time(7 * s, 1000 * s) == 1000 * s


def test_a_late_row_follows_the_envelope_and_an_early_one_keeps_its_arrival() -> None:
    clock = _Clock()
    clock.host_time(0, 1000 * s)
    assert clock.host_time(1 * s, 1001 * s + 30 * ms) == 1001 * s
    assert clock.host_time(2 * s, 1002 * s - 5 * ms) == 1002 * s - 5 * ms
    assert (
        clock.host_time(2 * s + ms, 1002 * s + 40 * ms) == 1002 * s - 4 * ms
    )  # in that block: the way is shorter


def test_a_drift_is_learnt_from_the_rows_that_were_least_late() -> None:
    clock = _Clock()
    for row in range(2000):
        late = row % 7 * ms
        placed = clock.host_time(row * 10 * ms, 1000 * s + round(row * 10.005 * ms) + late)
        assert row < 1000 or placed == pytest.approx(1000 * s + row * 10.005 * ms, abs=0.02 * ms)
    assert clock.state[1][SLOPE] == pytest.approx(0.0005, rel=1e-3)


@pytest.mark.parametrize(
    ("device", "arrival", "begins"),
    [
        (s, s, False),
        (s, s + 100 * ms, False),
        (s, s + 101 * ms, True),  # the clocks disagree
        (s, s - 101 * ms, True),
        (-1, s, True),  # the device's went back
        (PAUSE * 6 * s, PAUSE * 6 * s, False),
        (PAUSE * 6 * s + 1, PAUSE * 6 * s + 1, True),  # too long a pause
    ],
)
def test_another_clock_and_a_long_pause_begin_an_epoch(device: int, arrival: int, *, begins: bool) -> None:
    clock = _Clock()
    assert clock.starts_epoch(5 * s, 1000 * s)
    clock.host_time(5 * s, 1000 * s)
    assert clock.starts_epoch(5 * s + device, 1000 * s + arrival) is begins
    clock.host_time(5 * s + device, 1000 * s + arrival)
    assert clock.state[0][EPOCH] == int(begins)


@pytest.mark.parametrize("wrong", [{"window": BLOCKS - 1}, {"drift": -1e-9}, {"jump": -1}])
def test_invalid_parameters_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        _Clock(**wrong)
