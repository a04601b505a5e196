"""A device's clock on the host: when was what the device stamped?

A source stamps rows with their arrival, which comes late, now more, now less. `DeviceClock` gives them the
host time of the device's own stamp instead, up to the constant part of the way, which nobody can see from one
end. Record the raw stream too: it keeps both stamps as they were, and `fit_clock` knows better afterwards.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from operators.batch import EVERY, Clocks, Motion, Times, concat, s
from operators.envelope import Envelope, line
from operators.operator import Operator


@dataclass
class DeviceClock(Operator[Motion, Motion]):
    """Put each row at the host time of its device stamp; what it takes is stamped with its arrival.

    Online, so a row is placed by what came before it: by the lower envelope of (arrival - device stamp) over
    a `window`, a line with an offset and a drift (see `operators.envelope`). Time never decreases, and is
    never later than the arrival. For some seconds after an epoch began it is wrong by about the least
    lateness seen so far, then by some 0.1 ms where rows are up to 20 ms late. Where hardly any row comes in
    time, it stays wrong by about the least lateness of a `window`. When the way gets longer for good, as over
    another network, the times follow within a `window`; a drift that changes is followed as slowly.

    An epoch begins where the device's clock goes back, as a controller's does when it restarts, where it
    disagrees with the host's by more than `jump` about how far two rows lie apart, and after five windows
    without a row.

    Raises:
        ParameterError: on a value that cannot be used.

    >>> from operators.batch import ms
    >>> device = np.arange(5) * 8 * ms
    >>> late = np.array([3, 0, 5, 1, 0]) * ms
    >>> motion = Motion(1_000 * s + device + late, device, np.zeros((5, 6)), np.zeros((5, 6)))
    >>> (DeviceClock().push(motion).time - 1_000 * s) // ms
    array([ 3,  8, 16, 24, 32])
    """

    window: int = 120 * s  # of device time
    drift: float = 200e-6  # s/s, at most; crystals stay below
    jump: int = 2 * s
    _envelope: Envelope = field(init=False, repr=False, compare=False)
    _newest: int | None = field(default=None, init=False, repr=False)  # ns, given

    def __post_init__(self) -> None:
        self._envelope = Envelope(self.window, self.drift, self.jump)

    def process(self, batch: Motion) -> Motion:
        """Place each row."""
        place, newest, times = self._envelope.place, self._newest, list[int]()
        for device, arrival in zip(batch.device_time.tolist(), batch.time.tolist(), strict=True):
            time = place(device, arrival)
            newest = time if newest is None else max(newest, time)
            times.append(newest)
        self._newest = newest
        return _at(batch, np.array(times, np.int64))


@dataclass
class WatchClock(Operator[Motion, Clocks]):
    """Tell every few seconds, and when an epoch ends, how the device's clock stands to the host's.

    It takes the rows that `DeviceClock` takes, has its parameters, and draws the same lines. The residual is
    by how much the rows since the last telling came late, in the mean.
    """

    window: int = 120 * s  # of device time
    drift: float = 200e-6  # s/s, at most
    jump: int = 2 * s
    every: int = 5 * s  # of device time
    _envelope: Envelope = field(init=False, repr=False, compare=False)
    _since: int = field(default=0, init=False, repr=False)  # ns, device stamp of the first row not told of
    _rows: int = field(default=0, init=False, repr=False)  # not told of
    _late: int = field(default=0, init=False, repr=False)  # ns, all of them together
    _placed: int = field(default=0, init=False, repr=False)  # ns, host time of the newest
    _told: int | None = field(default=None, init=False, repr=False)  # ns, of the newest row given
    _finger: int = field(default=EVERY, init=False, repr=False)

    def __post_init__(self) -> None:
        self._envelope = Envelope(self.window, self.drift, self.jump)

    def process(self, batch: Motion) -> Clocks:
        """Give what the rows complete."""
        envelope, told = self._envelope, list[Clocks]()
        self._finger = batch.finger
        for device, arrival in zip(batch.device_time.tolist(), batch.time.tolist(), strict=True):
            if self._rows and (device - self._since >= self.every or envelope.begins(device, arrival)):
                told.append(self._tell())
            if not self._rows:
                self._since = device
            self._placed = envelope.place(device, arrival)
            self._rows += 1
            self._late += arrival - self._placed
        return concat(Clocks, told)

    def flush(self) -> Clocks:
        """Give what the last rows tell."""
        return self._tell() if self._rows else Clocks.empty()

    def _tell(self) -> Clocks:
        envelope = self._envelope
        time = self._placed if self._told is None else max(self._told, self._placed)
        offset, residual = self._placed - envelope.device, self._late / self._rows / s
        self._told, self._rows, self._late = time, 0, 0
        return _clocks(time, offset, envelope.slope, residual, self._finger)


def fit_clock(motion: Motion, *, drift: float = 200e-6, jump: int = 2 * s) -> tuple[Motion, Clocks]:
    """Do for a whole recording what `DeviceClock` does online: one line under all rows of an epoch.

    Up to the constant part of the way, time is then right within some 0.01 ms where rows are up to 20 ms late
    and the drift is constant. A residual that is larger than online shows a drift that was not.

    Args:
        motion: Rows as received, in their order.
        drift: As in `DeviceClock`, s/s.
        jump: As in `DeviceClock`, ns.

    Returns:
        The rows at the host times of their device stamps, and for each epoch how its clock stood to the
        host's when it began.
    """
    if not len(motion):
        return motion, Clocks.empty()
    steps, gone = np.diff(motion.device_time), np.diff(motion.time)  # (n - 1,) ns
    cuts = np.flatnonzero((steps < 0) | (np.abs(gone - steps) > jump)) + 1
    time, clocks = np.empty_like(motion.time), list[Clocks]()
    for start, stop in pairwise([0, *cuts.tolist(), len(motion)]):
        device, arrival = motion.device_time[start:stop], motion.time[start:stop]
        x = device - device[0]
        y = arrival - arrival[0] - x
        offset, slope = line(x.astype(np.float64), y.astype(np.float64), drift)
        time[start:stop] = arrival[0] + x + np.rint(offset + slope * x).astype(np.int64)
        first, late = time.item(start), float((arrival - time[start:stop]).mean()) / s
        clocks.append(_clocks(first, first - device.item(0), slope, late, motion.finger))
    return _at(motion, np.maximum.accumulate(time)), concat(Clocks, clocks)


def _at(motion: Motion, time: Times) -> Motion:
    return Motion(time, motion.device_time, motion.velocity, motion.pose, finger=motion.finger)


def _clocks(time: int, offset: int, drift: float, residual: float, finger: int) -> Clocks:
    columns = np.array([time]), np.array([offset]), np.array([drift]), np.array([residual])
    return Clocks(*columns, finger=finger)
