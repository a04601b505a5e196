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

from dataclasses import dataclass, field
from math import inf
from typing import Final, TypeAlias

import numpy as np

from operators.batch import EVERY, Clocks, Motion, Reals, Times, s
from operators.checks import check_at_least
from operators.operator import Operator
from operators.row_loop import row_loop
from operators.row_queues import END

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
    _envelope: Envelope = field(init=False, repr=False, compare=False)
    _newest: int = field(default=-END, init=False, repr=False)  # ns, of the output

    def __post_init__(self) -> None:
        self._envelope = envelope("DeviceClock", self.window, self.jump)

    def process(self, batch: Motion) -> Motion:
        """Return the rows with host times."""
        time = np.empty(batch.time.size, np.int64)
        self._newest = _host_times(batch.device_time, batch.time, self._newest, self._envelope, time)
        return Motion(time, batch.device_time, batch.velocity, batch.pose, finger=batch.finger)


@row_loop
def _host_times(device: Times, arrival: Times, /, newest: int, state: Envelope, host: Times) -> int:
    for row in range(len(device)):
        newest = max(newest, host_time(device[row], arrival[row], state))
        host[row] = newest
    return newest


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
    _envelope: Envelope = field(init=False, repr=False, compare=False)
    _open: Times = field(init=False, repr=False, compare=False)
    _finger: int = field(default=EVERY, init=False, repr=False)

    def __post_init__(self) -> None:
        check_at_least("WatchClock", "every", self.every, 1, "ns")
        self._envelope = envelope("WatchClock", self.window, DeviceClock.jump)
        self._open = np.array([0, 0, 0, 0, -END])

    def process(self, batch: Motion) -> Clocks:
        """Return the reports that the rows complete."""
        self._finger = batch.finger
        stamps, lines = np.empty((2, batch.time.size), np.int64), np.empty((2, batch.time.size))
        state = self._envelope, self._open
        count = _watch(batch.device_time, batch.time, state, self.every, stamps, lines)
        if not count:
            return Clocks.empty()
        return self._clocks(stamps[:, :count].copy(), lines[:, :count].copy())  # sinks may keep them

    def flush(self) -> Clocks:
        """Return the report of the remaining rows."""
        if not self._open[_ROWS]:
            return Clocks.empty()
        stamps, lines = np.empty((2, 1), np.int64), np.empty((2, 1))
        _report(self._envelope, self._open, stamps, lines, 0)
        return self._clocks(stamps, lines)

    def _clocks(self, stamps: Times, lines: Reals) -> Clocks:
        return Clocks(stamps[0], stamps[1], lines[0], lines[1], finger=self._finger)


# Rows since the last report: device stamp of the first (ns), number, total lateness (ns); host time of the
# newest row and time of the newest report (ns).
_SINCE, _ROWS, _LATE, _MAPPED, _REPORTED = range(5)


@row_loop
def _watch(
    device: Times, arrival: Times, /, state: tuple[Envelope, Times], every: int, stamps: Times, lines: Reals
) -> int:
    """Write time and offset, drift and residual of each report, and return their number."""
    clock, since = state
    count = 0
    for row in range(len(device)):
        stamp, came = device[row], arrival[row]
        if since[_ROWS] and (stamp - since[_SINCE] >= every or starts_epoch(stamp, came, clock)):
            _report(clock, since, stamps, lines, count)
            count += 1
        if not since[_ROWS]:
            since[_SINCE] = stamp
        since[_MAPPED] = host_time(stamp, came, clock)
        since[_ROWS] += 1
        since[_LATE] += came - since[_MAPPED]
    return count


def _report(clock: Envelope, since: Times, stamps: Times, lines: Reals, number: int) -> None:
    integers, reals, _ = clock
    since[_REPORTED] = max(since[_REPORTED], since[_MAPPED])
    stamps[0, number], stamps[1, number] = since[_REPORTED], since[_MAPPED] - integers[DEVICE]
    lines[0, number], lines[1, number] = reals[SLOPE], since[_LATE] / since[_ROWS] / s
    since[_ROWS] = since[_LATE] = 0


def envelope(owner: str, window: int, jump: int) -> Envelope:
    """Return the initial state of the running envelope of a stream.

    Time is divided into blocks of 1/60 `window`. A block starts with the line below the 60 blocks before it.
    A row below the line lowers it. At the end of the block the line is fitted again.

    Args:
        owner: Operator that has the parameters, for errors.
        window: Length, ns of device time.
        jump: Largest disagreement on an interval, ns.

    Raises:
        ParameterError: if a parameter is invalid.
    """
    check_at_least(owner, "window", window, BLOCKS, "ns")
    check_at_least(owner, "jump", jump, 0, "ns")
    integers = np.zeros(11, np.int64)
    integers[_WINDOW], integers[_JUMP], integers[EPOCH] = window, jump, -1
    return integers, np.zeros(4), np.zeros((2, BLOCKS))


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
