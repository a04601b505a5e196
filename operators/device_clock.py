"""Conversion of device time stamps to host time.

A source stamps rows at arrival, after a varying delay. `DeviceClock` replaces the arrival time by the host
time of the device's own stamp, up to the constant part of the delay, which cannot be measured from one end.
Record the raw stream as well: it keeps both stamps.
"""

from dataclasses import dataclass, field

import numpy as np

from operators.batch import EVERY, Clocks, Motion, Reals, Times, s
from operators.chain import END
from operators.checks import check_at_least
from operators.envelope import DEVICE, SLOPE, Envelope, envelope, host_time, starts_epoch
from operators.operator import Operator
from operators.row_loop import row_loop


@dataclass
class DeviceClock(Operator[Motion, Motion]):
    """Replace arrival times by the host times of the device's own stamps.

    The host time of a row follows from the lower envelope of (arrival - device stamp) over the `window`
    before it: a line with offset and drift (Moon et al. 1999; see `operators.envelope`). Time never decreases
    and is never later than the arrival. During the first seconds of an epoch the error is about the smallest
    delay so far; after that about 0.1 ms if rows are up to 20 ms late. If the delay increases permanently or
    the drift changes, the times follow within a `window`.

    A new epoch starts when the device's clock steps back (a controller restart), when device and host
    disagree by more than `jump` on the interval between two rows, and after five windows without rows.

    Args:
        window: Length of the envelope in device time, ns.
        drift: Largest drift, s/s; crystals stay below 200e-6.
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
    drift: float = 200e-6
    jump: int = 2 * s
    _envelope: Envelope = field(init=False, repr=False, compare=False)
    _newest: int = field(default=-END, init=False, repr=False)  # ns, of the output

    def __post_init__(self) -> None:
        self._envelope = envelope("DeviceClock", self.window, self.drift, self.jump)

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

    Takes the same input and parameters as `DeviceClock` and uses the same envelope. The residual is the mean
    lateness of the rows since the last report.

    Args:
        window: As in `DeviceClock`, ns.
        drift: As in `DeviceClock`, s/s.
        jump: As in `DeviceClock`, ns.
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
    drift: float = 200e-6
    jump: int = 2 * s
    every: int = 5 * s
    _envelope: Envelope = field(init=False, repr=False, compare=False)
    _open: Times = field(init=False, repr=False, compare=False)
    _finger: int = field(default=EVERY, init=False, repr=False)

    def __post_init__(self) -> None:
        check_at_least("WatchClock", "every", self.every, 1, "ns")
        self._envelope = envelope("WatchClock", self.window, self.drift, self.jump)
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
def _watch(  # noqa: PLR0917 - compiled functions take no keywords
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
