"""The lower envelope of (arrival - device stamp): what a device's clock shows, seen through a late network.

With x the device's stamp and y = arrival - x, both since the first row, a row comes at the clock's offset
plus however late it is, and never early. So the clock is the highest line under all rows::

    minimise mean(y - a - b x)  with  a + b x <= y  for every row

a is its offset, b its drift. It touches the rows that were least late, and is the edge of the lower convex
hull under the mean of x. Source: Moon, Skelly, Towsley, "Estimation and removal of clock skew from network
delay measurements", INFOCOM 1999.
"""

from dataclasses import dataclass, field
from math import inf
from typing import Final

import numpy as np

from operators.batch import Reals, s
from operators.errors import ParameterError

BLOCKS: Final = 60  # of a window: of each the row that was least late is kept
PAUSE: Final = 5  # windows
_SPAN: Final = 5 * s


def line(x: Reals, y: Reals, limit: float) -> tuple[float, float]:
    """The line under rows (n,), n at least 1, in the order of their x.

    Args:
        x: Device stamps, ns since any of them.
        y: Arrivals after those, ns.
        limit: The steepest that it may be, either way (s/s). It is level where the rows cover less than five
            seconds: they do not tell of a drift.

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
    """The envelope of a stream so far, and where it puts each row.

    Time is cut into blocks of a `window`'s sixtieth. The line under the sixty that came before a block holds
    for all of it, sunk under every row that came earlier than the line says. Then it is drawn again.

    A new epoch begins where the device's clock goes back, or where the two clocks disagree about how far two
    rows lie apart by more than `jump`: that is another clock, and nothing is known of it. So it does after a
    pause of five windows, by when the drift may have changed.

    Raises:
        ParameterError: on a value that cannot be used.
    """

    window: int  # ns of device time
    drift: float  # s/s, at most
    jump: int  # ns
    epoch: int = -1  # counts from 0
    device: int = 0  # ns, stamp of the newest row
    arrival: int = 0  # ns, of the newest row
    offset: float = 0.0  # ns, of the line at the epoch's first row
    slope: float = 0.0  # s/s, of the line
    _origin: int = 0  # ns, device stamp of the epoch's first row
    _began: int = 0  # ns, its arrival
    _sunk: float = 0.0  # ns, at most 0
    _block: int = 0  # number of the present one
    _least: tuple[int, int, float] = (0, 0, inf)  # x, y and lateness of its row that was least late
    _kept: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])  # x and y, by block

    def __post_init__(self) -> None:
        for name, least, unit in (("window", BLOCKS, "ns"), ("drift", 0, "s/s"), ("jump", 0, "ns")):
            if not getattr(self, name) >= least:
                raise ParameterError("DeviceClock", name, getattr(self, name), f"at least {least} {unit}")

    def begins(self, device: int, arrival: int) -> bool:
        """Whether the next row, with these stamps (ns), begins an epoch."""
        step = device - self.device
        known = 0 <= step <= PAUSE * self.window and abs(arrival - self.arrival - step) <= self.jump
        return self.epoch < 0 or not known

    def place(self, device: int, arrival: int) -> int:
        """Take the next row's stamps (ns); give the host time of the device's (ns), which is no later."""
        if self.begins(device, arrival):
            self.epoch += 1
            self._origin, self._began, self._block, self._kept = device, arrival, 0, []
            self.offset = self.slope = self._sunk = 0.0
            self._least = 0, 0, inf
        self.device, self.arrival = device, arrival
        x = device - self._origin
        y = arrival - self._began - x
        if (block := x * BLOCKS // self.window) != self._block:
            self._block = block
            self._draw()
        lateness = y - (self.offset + self.slope * x)
        if lateness < self._least[2]:
            self._least = x, y, lateness
            self._sunk = min(self._sunk, lateness)
        return min(arrival, self._began + x + round(self.offset + self.slope * x + self._sunk))

    def _draw(self) -> None:
        """Draw the line under the newest blocks."""
        self._kept = [*self._kept[1 - BLOCKS :], self._least[:2]]
        x, y = np.array(self._kept, np.float64).T  # (blocks,) each
        self.offset, self.slope = line(x, y, self.drift)
        self._sunk, self._least = 0.0, (0, 0, inf)
