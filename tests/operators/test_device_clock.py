from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators import DeviceClock, Motion, ms, s
from operators.batch import Reals, Times
from operators.device_clock import line

START = 1_700_000_000 * s
UP = 3600 * s  # that the device had been on
Way = Callable[[np.random.Generator, Reals], Reals]


def motion(device: Times, arrival: Times) -> Motion:
    nothing = np.zeros((len(device), 6))
    return Motion(arrival, device, nothing, nothing)


def independent(random: np.random.Generator, sent: Reals) -> Reals:
    """Each package up to 20 ms late, none overtaking another."""
    return np.maximum.accumulate(sent + random.uniform(0, 0.02, len(sent)))


def woken(random: np.random.Generator, sent: Reals) -> Reals:
    """A reader that is kept away for up to 20 ms, again and again, and then takes what is there."""
    times = 100 + round(float(sent[-1]) * 120)
    wakes: Reals = np.cumsum(random.uniform(0, 0.02, times))
    return wakes[np.searchsorted(wakes, sent)]


def late(way: Way, rate: float, drift: float, seconds: int = 600) -> tuple[Motion, Times]:
    """A stream from a device whose clock drifts, over a way of 5 ms at least; and when it was sent."""
    sent = np.arange(seconds * rate) / rate
    device = UP + np.rint(sent * (1 + drift) * s).astype(np.int64)
    arrival = START + 5 * ms + np.rint(way(np.random.default_rng(0), sent) * s).astype(np.int64)
    return motion(device, arrival), START + 5 * ms + np.rint(sent * s).astype(np.int64)


def p99(time: Times, true: Times) -> float:
    """Return the quantiles of the error, ms."""
    return float(np.percentile(np.abs(time - true), 99)) / ms


@pytest.mark.parametrize("drift", [50e-6, -50e-6])
@pytest.mark.parametrize(("way", "rate"), [(independent, 125.0), (woken, 125.0), (woken, 500.0)])
def test_20_ms_of_jitter_and_50_ppm_leave_half_a_millisecond(way: Way, rate: float, drift: float) -> None:
    stream, true = late(way, rate, drift)
    live = DeviceClock().push(stream).time
    assert p99(live, true) < 0.5
    assert p99(live[len(live) // 10 :], true[len(live) // 10 :]) < 0.15
    assert p99(stream.time, true) > 15


@given(
    steps=st.lists(
        st.tuples(
            st.sampled_from([0, 1, 8 * ms, 8 * ms, 8 * ms, 3 * s, -(5 * s)]),
            st.sampled_from([0, 0, 1, 8 * ms, 8 * ms, 20 * ms, 3 * s]),
        ),
        min_size=1,
        max_size=80,
    )
)
def test_time_never_decreases_and_is_never_later_than_the_arrival(steps: list[tuple[int, int]]) -> None:
    device, arrival = np.cumsum(np.array(steps, np.int64), axis=0).T
    stream = motion(100 * s + device, START + arrival)
    mapped = DeviceClock(window=s).push(stream)
    assert (np.diff(mapped.time) >= 0).all()
    assert (mapped.time <= stream.time).all()


def restarted(away: int, up: int) -> tuple[Motion, Times]:
    """A minute of a device, then it is away for a while (ns), and back, having been up for another."""
    first, true = late(woken, 125.0, 50e-6, seconds=60)
    gone = true[-1] - true[0] + away
    device = np.concatenate((first.device_time, first.device_time - UP + up))
    arrival = np.concatenate((first.time, first.time + gone))
    return motion(device, arrival), np.concatenate((true, true + gone))


@pytest.mark.parametrize(
    ("away", "up"),
    [(s // 2, s // 4), (30 * s, 0), (30 * s, UP + 70 * s), (300 * s, UP + 61 * s)],
    ids=["at once", "after a while", "with a later stamp", "with a much earlier one than is due"],
)
def test_another_clock_begins_a_new_epoch(away: int, up: int) -> None:
    stream, true = restarted(away, up)
    again = len(stream) // 2
    error = np.abs(DeviceClock().push(stream).time - true)
    assert error[again:].max() < 20 * ms
    assert np.percentile(error[again + 250 :], 99) < 0.5 * ms


@pytest.mark.parametrize(
    ("pause", "delay", "begins"), [(5 * s, 100 * ms, False), (5 * s + 1, 100 * ms, True), (s, 101 * ms, True)]
)
def test_a_long_pause_and_a_jump_begin_a_new_epoch(pause: int, delay: int, *, begins: bool) -> None:
    device = np.array([0, pause])
    stream = motion(device, START + device + np.array([0, delay]))
    mapped = DeviceClock(window=s, jump=100 * ms).push(stream)
    assert (mapped.time[1] == stream.time[1]) == begins


@pytest.mark.parametrize("longer", [3, -3])
def test_a_way_of_another_length_is_followed(longer: int) -> None:
    stream, true = late(woken, 125.0, 50e-6)
    shift = np.where(true > true[0] + 300 * s, longer * ms, 0)
    mapped = DeviceClock().push(motion(stream.device_time, np.maximum.accumulate(stream.time + shift)))
    error = np.abs(mapped.time - true - shift)
    assert error.max() < 20 * ms
    assert error[440 * 125 :].max() < 0.1 * ms


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
