"""Lower envelope of (arrival - device stamp): the device's clock without the delay of the network.

With x the device stamp and y = arrival - x, both relative to the first row, y is the clock's offset plus a
delay that is never negative. So the clock is the highest line under all rows::

    minimise mean(y - a - b x)  with  a + b x <= y  for every row

a is the offset, b the drift. The line is the edge of the lower convex hull below the mean of x.

References:
    Moon, Skelly, Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM
    1999.
"""

from math import inf
from typing import Final, TypeAlias

import numpy as np

from operators.batch import Reals, Times, s
from operators.checks import check_at_least

BLOCKS: Final = 60  # per window; the least late row of each block is kept
PAUSE: Final = 5  # windows without rows, after which a new epoch starts
_SPAN: Final = 5 * s  # minimum span of rows for a drift estimate

Envelope: TypeAlias = tuple[Times, Reals, Reals]  # integers, reals, (2, BLOCKS) x and y of each kept row

# Integers: window and largest jump (ns); number of the epoch; stamps of the newest row and of the epoch's
# first row (ns); current block; x and y of the block's least late row; number of kept rows.
_WINDOW, _JUMP, EPOCH, DEVICE, _ARRIVAL, _ORIGIN, _BEGAN, _BLOCK, _LEAST_X, _LEAST_Y, _KEPT = range(11)
# Reals: largest drift; offset (ns) and slope of the line at the epoch's first row; its shift in this block,
# at most 0 (ns); lateness of the block's least late row (ns).
_DRIFT, OFFSET, SLOPE, _LOWERED, _LEAST = range(5)


def envelope(owner: str, window: int, drift: float, jump: int) -> Envelope:
    """Return the initial state of the running envelope of a stream.

    Time is divided into blocks of 1/60 `window`. A block starts with the line below the 60 blocks before it.
    A row below the line lowers it. At the end of the block the line is fitted again.

    A new epoch starts when the device's clock steps back, when device and host disagree by more than `jump`
    on the interval between two rows, or after five windows without rows.

    Args:
        owner: Operator that has the parameters, for errors.
        window: Length, ns of device time.
        drift: Largest drift, s/s.
        jump: Largest disagreement on an interval, ns.

    Raises:
        ParameterError: if a parameter is invalid.
    """
    check_at_least(owner, "window", window, BLOCKS, "ns")
    check_at_least(owner, "drift", drift, 0, "s/s")
    check_at_least(owner, "jump", jump, 0, "ns")
    integers, reals = np.zeros(11, np.int64), np.zeros(5)
    integers[_WINDOW], integers[_JUMP], integers[EPOCH], reals[_DRIFT] = window, jump, -1, drift
    return integers, reals, np.zeros((2, BLOCKS))


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
    reals[OFFSET], reals[SLOPE] = line(kept[0, : count + 1], kept[1, : count + 1], reals[_DRIFT])
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
