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
from typing import Final

import numpy as np

from operators.batch import Motion, Reals, s
from operators.checks import check_at_least
from operators.operator import Operator
from operators.steps import END, Record, RowType, Steps, copy

BLOCKS: Final = 60  # per window; the least late row of each block is kept
PAUSE: Final = 5  # windows without rows, after which a new epoch starts
DRIFT: Final = 200e-6  # s/s, largest drift; crystals stay below
_SPAN: Final = 5 * s  # minimum span of rows for a drift estimate


@dataclass
class DeviceClock(Operator[Motion, Motion]):
    """Replace the arrival time of each row by the host time at which the device measured it.

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
        check_at_least("DeviceClock", "window", self.window, BLOCKS, "ns")
        check_at_least("DeviceClock", "jump", self.jump, 0, "ns")

    def steps(self, *given: RowType) -> Steps:
        """Return the step, with the envelope as its state.

        Time is divided into blocks of 1/60 `window`. A block starts with the line below the 60 blocks before
        it. A row below the line lowers it. At the end of the block the line is fitted again.
        """
        return Steps(
            settings={"window": self.window, "jump": self.jump},
            state={
                "begun": 0,  # there is an epoch
                "stamp": 0,  # ns, of the device, of the newest row
                "arrival": 0,  # ns, of the newest row
                "origin": 0,  # ns, stamp of the epoch's first row
                "began": 0,  # ns, arrival of that row
                "block": 0,  # number of the current block
                "least_x": 0,  # ns, of the block's least late row
                "least_y": 0,  # ns, of that row
                "lateness": inf,  # ns, of that row
                "kept": 0,  # number of blocks that are kept
                "x": np.zeros(BLOCKS),  # ns, of the least late row of each
                "y": np.zeros(BLOCKS),  # ns
                "offset": 0.0,  # ns, of the line at the epoch's first row
                "slope": 0.0,
                "lowered": 0.0,  # ns, shift of the line in this block, at most 0
                "newest": -END,  # ns, host time of the newest row
            },
            step=_host_time,
        )


def _host_time(settings: Record, state: Record, row: Record, out: Record) -> bool:
    """Give the row its host time, no later than its arrival."""
    copy(out, row)
    device, arrival = row.device_time, row.time
    step = device - state.stamp
    continuous = 0 <= step <= PAUSE * settings.window
    agrees = abs(arrival - state.arrival - step) <= settings.jump
    if not (state.begun and continuous and agrees):  # begin an epoch
        state.begun, state.origin, state.began = 1, device, arrival
        state.block = state.kept = 0
        state.offset = state.slope = state.lowered = 0.0
        state.lateness = inf
    state.stamp, state.arrival = device, arrival
    x = device - state.origin
    y = arrival - state.began - x
    block = x * BLOCKS // settings.window
    if block != state.block:
        state.block = block
        _fit(state)
    lateness = y - (state.offset + state.slope * x)
    if lateness < state.lateness:
        state.least_x, state.least_y, state.lateness = x, y, lateness
        state.lowered = min(state.lowered, lateness)
    shift = round(float(state.offset + state.slope * x + state.lowered))
    state.newest = out.time = max(state.newest, min(arrival, state.began + x + shift))
    return True


def _fit(state: Record) -> None:
    """Fit the line to the newest blocks."""
    count = state.kept
    if count == BLOCKS:
        count -= 1
        for block in range(count):
            state.x[block], state.y[block] = state.x[block + 1], state.y[block + 1]
    state.x[count], state.y[count] = state.least_x, state.least_y
    state.kept = count + 1
    state.offset, state.slope = line(state.x[: count + 1], state.y[: count + 1], DRIFT)
    state.lowered, state.lateness = 0.0, inf


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
        lowest = int(np.argmin(y - drift * x))
        above = y[lowest] - drift * x[lowest]
        if lowest in (left, right) or above >= min(y[left] - drift * x[left], y[right] - drift * x[right]):
            break
        if x[lowest] <= middle:
            left = lowest
        else:
            right = lowest
    drift = min(max(drift, -limit), limit) if x[-1] - x[0] >= _SPAN else 0.0
    lowest = int(np.argmin(y - drift * x))
    return float(y[lowest] - drift * x[lowest]), drift
