"""Conversion of device time stamps to host time.

A source stamps rows at arrival, after a varying delay. `DeviceClock` replaces the arrival time by the host
time of the device's own stamp, up to the constant part of the delay, which cannot be measured from one end.
Record the raw stream as well: it keeps both stamps.

With x the device stamp and y = arrival - x, both relative to the first row, y is the clock's offset plus a
delay that is never negative. So the clock is the highest line under all rows::

    minimise mean(y - a - b x)  with  a + b x <= y  for every row

a is the offset, b the drift. The line is the edge of the lower convex hull below the mean of x.

References:
    Moon, Skelly, Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM
    1999.
"""

from dataclasses import dataclass
from math import inf
from typing import Any, Final, TypeAlias

import numpy as np

from operators.batch import Clocks, Motion, Reals, Times, s
from operators.checks import check_at_least
from operators.operator import Operator
from operators.steps import END, Record, RowType, Steps, copy

BLOCKS: Final = 60  # per window; the least late row of each block is kept
PAUSE: Final = 5  # windows without rows, after which a new epoch starts
DRIFT: Final = 200e-6  # s/s, largest drift; crystals stay below
_SPAN: Final = 5 * s  # minimum span of rows for a drift estimate

Envelope: TypeAlias = tuple[Times, Reals, Reals]  # integers, reals, (2, BLOCKS) x and y of each kept row

# Integers: window and largest jump (ns); number of the epoch; stamps of the newest row and of the epoch's
# first row (ns); current block; x and y of the block's least late row; number of kept rows.
_WINDOW, _JUMP, EPOCH, DEVICE, _ARRIVAL, _ORIGIN, _BEGAN, _BLOCK, _LEAST_X, _LEAST_Y, _KEPT = range(11)
# Reals: offset (ns) and slope of the line at the epoch's first row; its shift in this block, at most 0 (ns);
# lateness of the block's least late row (ns).
OFFSET, SLOPE, _LOWERED, _LEAST = range(4)


@dataclass
class DeviceClock(Operator[Motion, Motion]):
    """Replace arrival times by the host times of the device's own stamps.

    The host time of a row follows from the lower envelope of (arrival - device stamp) over the `window`
    before it: a line with offset and drift (Moon et al. 1999). Time never decreases and is
    never later than the arrival. During the first seconds of an epoch the error is about the smallest
    delay so far; after that about 0.1 ms if rows are up to 20 ms late. If the delay increases permanently or
    the drift changes, the times follow within a `window`.

    A new epoch starts when the device's clock steps back (a controller restart), when device and host
    disagree by more than `jump` on the interval between two rows, and after five windows without rows.

    Args:
        window: Length of the envelope in device time, ns.
        jump: Largest disagreement on an interval within an epoch, ns.

    Raises:
        ParameterError: if a parameter is invalid.

    >>> from operators.batch import ms
    >>> device = np.arange(5) * 8 * ms
    >>> late = np.array([3, 0, 5, 1, 0]) * ms
    >>> motion = Motion(1_000 * s + device + late, device, np.zeros((5, 6)), np.zeros((5, 6)))
    >>> (DeviceClock().push(motion).time - 1_000 * s) // ms
    array([ 3,  8, 16, 24, 32])
    """

    window: int = 120 * s
    jump: int = 2 * s

    def __post_init__(self) -> None:
        check_window("DeviceClock", self.window, self.jump)

    def steps(self, *given: RowType) -> Steps:
        """Return the step."""
        return Steps(state={**envelope(self.window, self.jump), "newest": -END}, step=_host_times)


def _host_times(settings: Record, state: Record, row: Record, out: Record) -> bool:
    copy(out, row)
    clock = state.integers, state.reals, state.kept
    state.newest = out.time = max(state.newest, host_time(row.device_time, row.time, clock))
    return True


@dataclass
class WatchClock(Operator[Motion, Clocks]):
    """Report the offset and drift of the device's clock periodically and at the end of each epoch.

    Takes the same input as `DeviceClock` and uses the same envelope. The residual is the mean lateness of
    the rows since the last report.

    Args:
        window: As in `DeviceClock`, ns.
        every: Interval of the reports in device time, ns.

    Raises:
        ParameterError: if a parameter is invalid.

    >>> arrivals = np.arange(3) * 8 * 10**6
    >>> motion = Motion(1_000 * s + arrivals, arrivals, np.zeros((3, 6)), np.zeros((3, 6)))
    >>> clock = WatchClock(every=16 * 10**6)
    >>> (clock.push(motion).offset // s).tolist()
    [1000]
    """

    window: int = 120 * s
    every: int = 5 * s

    def __post_init__(self) -> None:
        check_at_least("WatchClock", "every", self.every, 1, "ns")
        check_window("WatchClock", self.window, DeviceClock.jump)

    def steps(self, *given: RowType) -> Steps:
        """Return the functions that take motion and give reports."""
        state = {
            "since": 0,  # ns, device stamp of the first row since the last report
            "rows": 0,  # since then
            "late": 0,  # ns, their total lateness
            "mapped": 0,  # ns, host time of the newest row
            "report": np.zeros((), RowType(Clocks).packed),  # the newest
            "waits": 0,  # the report was not given yet
            "ended": 0,
        }
        clock = envelope(self.window, DeviceClock.jump)
        return Steps({"every": self.every}, {**clock, **state}, takes=(_watch,), give=_give_report, held=1)


def _watch(settings: Record, state: Record, row: Record) -> None:
    clock, stamp = (state.integers, state.reals, state.kept), row.device_time
    if state.rows and (stamp - state.since >= settings.every or starts_epoch(stamp, row.time, clock)):
        _report(state)
    if not state.rows:
        state.since = stamp
    state.mapped = host_time(stamp, row.time, clock)
    state.rows += 1
    state.late += row.time - state.mapped


def _report(state: Record) -> None:
    report = state.report
    report.time = max(report.time, state.mapped)
    report.offset, report.drift = state.mapped - state.integers[DEVICE], state.reals[SLOPE]
    report.residual = state.late / state.rows / s
    state.rows = state.late = 0
    state.waits = 1


def _give_report(settings: Record, state: Record, out: Record) -> bool:
    if state.ended and state.rows:
        _report(state)
    if not state.waits:
        return False
    copy(out, state.report)
    state.waits = 0
    return True


def check_window(owner: str, window: int, jump: int) -> None:
    """Check the parameters of an envelope, ns.

    Raises:
        ParameterError: if a parameter is invalid.
    """
    check_at_least(owner, "window", window, BLOCKS, "ns")
    check_at_least(owner, "jump", jump, 0, "ns")


def envelope(window: int, jump: int) -> dict[str, Any]:
    """Return the initial state of the running envelope of a stream.

    Time is divided into blocks of 1/60 `window`. A block starts with the line below the 60 blocks before it.
    A row below the line lowers it. At the end of the block the line is fitted again.

    Args:
        window: Length, ns of device time.
        jump: Largest disagreement on an interval, ns.
    """
    integers = np.zeros(11, np.int64)
    integers[_WINDOW], integers[_JUMP], integers[EPOCH] = window, jump, -1
    return {"integers": integers, "reals": np.zeros(4), "kept": np.zeros((2, BLOCKS))}


def starts_epoch(device: int, arrival: int, state: Envelope) -> bool:
    """Return whether the next row, with these stamps (ns), starts an epoch."""
    integers = state[0]
    step = device - integers[DEVICE]
    continuous = 0 <= step <= PAUSE * integers[_WINDOW]
    agrees = abs(arrival - integers[_ARRIVAL] - step) <= integers[_JUMP]
    return integers[EPOCH] < 0 or not (continuous and agrees)


def host_time(device: int, arrival: int, state: Envelope) -> int:
    """Return the host time (ns) of the next row, no later than its arrival."""
    integers, reals, _ = state
    if starts_epoch(device, arrival, state):
        integers[EPOCH] += 1
        integers[_ORIGIN], integers[_BEGAN], integers[_BLOCK], integers[_KEPT] = device, arrival, 0, 0
        reals[OFFSET], reals[SLOPE], reals[_LOWERED], reals[_LEAST] = 0.0, 0.0, 0.0, inf
    integers[DEVICE], integers[_ARRIVAL] = device, arrival
    x = device - integers[_ORIGIN]
    y = arrival - integers[_BEGAN] - x
    block = x * BLOCKS // integers[_WINDOW]
    if block != integers[_BLOCK]:
        integers[_BLOCK] = block
        _fit(state)
    lateness = y - (reals[OFFSET] + reals[SLOPE] * x)
    if lateness < reals[_LEAST]:
        integers[_LEAST_X], integers[_LEAST_Y], reals[_LEAST] = x, y, lateness
        reals[_LOWERED] = min(reals[_LOWERED], lateness)
    shift = round(float(reals[OFFSET] + reals[SLOPE] * x + reals[_LOWERED]))
    time: int = min(arrival, integers[_BEGAN] + x + shift)
    return time


def _fit(state: Envelope) -> None:
    """Fit the line to the newest blocks."""
    integers, reals, kept = state
    count = integers[_KEPT]
    if count == BLOCKS:
        count -= 1
        for block in range(count):
            kept[0, block], kept[1, block] = kept[0, block + 1], kept[1, block + 1]
    kept[0, count], kept[1, count] = integers[_LEAST_X], integers[_LEAST_Y]
    integers[_KEPT] = count + 1
    reals[OFFSET], reals[SLOPE] = line(kept[0, : count + 1], kept[1, : count + 1], DRIFT)
    reals[_LOWERED], reals[_LEAST] = 0.0, inf


def line(x: Reals, y: Reals, limit: float) -> tuple[float, float]:
    """Fit the highest line below all rows: x and y are (n,), ordered by x, with n at least 1.

    Args:
        x: Device stamps, ns relative to any origin.
        y: Arrival minus device stamp, ns.
        limit: Largest absolute drift, s/s. The drift is 0 if the rows cover less than five seconds.

    Returns:
        Offset at x = 0 (ns) and drift (s/s).

    >>> line(1e9 * np.array([0.0, 2, 4, 6]), 1e9 * np.array([0.0, 7, 8, 6]), limit=10)
    (0.0, 1.0)
    """
    left, right, drift, middle = 0, len(x) - 1, 0.0, 0.0
    for each in x:
        middle += float(each)
    middle /= len(x)
    while x[right] > x[left]:
        drift = float((y[right] - y[left]) / (x[right] - x[left]))
        lowest = _lowest(x, y, drift)
        above = y[lowest] - drift * x[lowest]
        if lowest in (left, right) or above >= min(y[left] - drift * x[left], y[right] - drift * x[right]):
            break
        if x[lowest] <= middle:
            left = lowest
        else:
            right = lowest
    drift = min(max(drift, -limit), limit) if x[-1] - x[0] >= _SPAN else 0.0
    lowest = _lowest(x, y, drift)
    return float(y[lowest] - drift * x[lowest]), drift


def _lowest(x: Reals, y: Reals, drift: float) -> int:
    """Return the index of the first row with the smallest y - drift * x."""
    lowest = 0
    for row in range(1, len(x)):
        if y[row] - drift * x[row] < y[lowest] - drift * x[lowest]:
            lowest = row
    return lowest
