"""Conversion of device time stamps to host time.

A source stamps rows at arrival, after a varying delay. `DeviceClock` replaces the arrival time by the host
time of the device's own stamp, up to the constant part of the delay, which cannot be measured from one end.
Record the raw stream as well: it keeps both stamps.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from operators.batch import EVERY, Clocks, Motion, concat, s
from operators.envelope import Envelope
from operators.operator import Operator


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
    _newest: int | None = field(default=None, init=False, repr=False)  # ns, of the output

    def __post_init__(self) -> None:
        self._envelope = Envelope(self.window, self.drift, self.jump)

    def process(self, batch: Motion) -> Motion:
        """Return the rows with host times."""
        host_time, newest, times = self._envelope.host_time, self._newest, list[int]()
        for device, arrival in zip(batch.device_time.tolist(), batch.time.tolist(), strict=True):
            time = host_time(device, arrival)
            newest = time if newest is None else max(newest, time)
            times.append(newest)
        self._newest = newest
        return replace(batch, time=np.array(times, np.int64))


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
    _since: int = field(default=0, init=False, repr=False)  # ns, device stamp of the first unreported row
    _rows: int = field(default=0, init=False, repr=False)  # unreported
    _late: int = field(default=0, init=False, repr=False)  # ns, their total lateness
    _mapped: int = field(default=0, init=False, repr=False)  # ns, host time of the newest row
    _reported: int | None = field(default=None, init=False, repr=False)  # ns, time of the newest report
    _finger: int = field(default=EVERY, init=False, repr=False)

    def __post_init__(self) -> None:
        self._envelope = Envelope(self.window, self.drift, self.jump)

    def process(self, batch: Motion) -> Clocks:
        """Return the reports that the rows complete."""
        envelope, reports = self._envelope, list[Clocks]()
        self._finger = batch.finger
        for device, arrival in zip(batch.device_time.tolist(), batch.time.tolist(), strict=True):
            if self._rows and (device - self._since >= self.every or envelope.starts_epoch(device, arrival)):
                reports.append(self._report())
            if not self._rows:
                self._since = device
            self._mapped = envelope.host_time(device, arrival)
            self._rows += 1
            self._late += arrival - self._mapped
        return concat(Clocks, reports)

    def flush(self) -> Clocks:
        """Return the report of the remaining rows."""
        return self._report() if self._rows else Clocks.empty()

    def _report(self) -> Clocks:
        envelope = self._envelope
        time = self._mapped if self._reported is None else max(self._reported, self._mapped)
        offset, residual = self._mapped - envelope.device, self._late / self._rows / s
        self._reported, self._rows, self._late = time, 0, 0
        values = (time, offset, envelope.slope, residual)
        return Clocks(*(np.array([value]) for value in values), finger=self._finger)
