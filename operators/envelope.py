"""Lower envelope of (arrival - device stamp): the device's clock without the delay of the network.

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
from typing import Final

import numpy as np

from operators.batch import Reals, s
from operators.checks import check_at_least

BLOCKS: Final = 60  # per window; the least late row of each block is kept
PAUSE: Final = 5  # windows without rows, after which a new epoch starts
_SPAN: Final = 5 * s  # minimum span of rows for a drift estimate


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
    middle, left, right, drift = float(x.mean()), 0, len(x) - 1, 0.0
    while x[right] > x[left]:
        drift = float((y[right] - y[left]) / (x[right] - x[left]))
        above = y - drift * x
        lowest = int(above.argmin())
        if lowest in (left, right) or above[lowest] >= min(above[left], above[right]):
            break
        if x[lowest] <= middle:
            left = lowest
        else:
            right = lowest
    drift = min(max(drift, -limit), limit) if x[-1] - x[0] >= _SPAN else 0.0
    return float((y - drift * x).min()), drift


@dataclass
class Envelope:
    """Running envelope of a stream.

    Time is divided into blocks of 1/60 `window`. A block starts with the line below the 60 blocks before it.
    A row below the line lowers it. At the end of the block the line is fitted again.

    A new epoch starts when the device's clock steps back, when device and host disagree by more than `jump`
    on the interval between two rows, or after five windows without rows.

    Raises:
        ParameterError: if a parameter is invalid.
    """

    window: int  # ns of device time
    drift: float  # s/s, largest
    jump: int  # ns, largest disagreement on an interval
    epoch: int = -1  # counts from 0
    device: int = 0  # ns, stamp of the newest row
    arrival: int = 0  # ns, of the newest row
    offset: float = 0.0  # ns, of the line, at the epoch's first row
    slope: float = 0.0  # s/s, of the line
    _origin: int = 0  # ns, device stamp of the epoch's first row
    _began: int = 0  # ns, arrival of the epoch's first row
    _lowered: float = 0.0  # ns, shift of the line in this block; at most 0
    _block: int = 0  # index of the current block
    _least: tuple[int, int, float] = (0, 0, inf)  # x, y and lateness of the block's least late row
    _kept: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])  # x and y, per block

    def __post_init__(self) -> None:
        check_at_least("DeviceClock", "window", self.window, BLOCKS, "ns")
        check_at_least("DeviceClock", "drift", self.drift, 0, "s/s")
        check_at_least("DeviceClock", "jump", self.jump, 0, "ns")

    def starts_epoch(self, device: int, arrival: int) -> bool:
        """Return whether the next row, with these stamps (ns), starts an epoch."""
        step = device - self.device
        continuous = 0 <= step <= PAUSE * self.window and abs(arrival - self.arrival - step) <= self.jump
        return self.epoch < 0 or not continuous

    def host_time(self, device: int, arrival: int) -> int:
        """Return the host time (ns) of the next row, no later than its arrival."""
        if self.starts_epoch(device, arrival):
            self.epoch += 1
            self._origin, self._began, self._block, self._kept = device, arrival, 0, []
            self.offset = self.slope = self._lowered = 0.0
            self._least = 0, 0, inf
        self.device, self.arrival = device, arrival
        x = device - self._origin
        y = arrival - self._began - x
        if (block := x * BLOCKS // self.window) != self._block:
            self._block = block
            self._fit()
        lateness = y - (self.offset + self.slope * x)
        if lateness < self._least[2]:
            self._least = x, y, lateness
            self._lowered = min(self._lowered, lateness)
        return min(arrival, self._began + x + round(self.offset + self.slope * x + self._lowered))

    def _fit(self) -> None:
        """Fit the line to the newest blocks."""
        self._kept = [*self._kept[1 - BLOCKS :], self._least[:2]]
        x, y = np.array(self._kept, np.float64).T  # (blocks,) each
        self.offset, self.slope = line(x, y, self.drift)
        self._lowered, self._least = 0.0, (0, 0, inf)
