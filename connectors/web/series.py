"""What a page shows of a stream's rows, and how it is written down as JSON."""

from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.batch import Motion, Reals, Scores, Times, Touch, ms
from operators.ports import Json

Real = TypeVar("Real", bound=np.floating[Any])
PAUSE: Final = 250 * ms  # ns; a longer one is drawn as a gap, as the page does it with live rows


def shown(batch: Touch | Motion | Scores) -> Reals:
    """What is drawn of a batch.

    Returns:
        (n, 6) counts of a touch, NaN where a cell did not answer; (n,) speed of the TCP, mm/s, of a motion;
        (n,) probability of scores.
    """
    if isinstance(batch, Touch):
        return np.where(batch.valid, batch.counts, np.nan)
    if isinstance(batch, Motion):
        speed: Reals = 1000 * np.sqrt(np.square(batch.velocity[:, :3]).sum(axis=1))
        return speed
    return batch.probability


def series(time: Times, values: NDArray[np.floating[Any]], origin: int) -> dict[str, Json]:
    """Rows as JSON: times in ms since `origin` (ns), values to three digits behind the point.

    >>> series(np.array([1_500_000, 2_000_000]), np.array([0.12345, 1.0]), 1_000_000)
    {'t': [0.5, 1.0], 'v': [0.123, 1.0]}
    """
    return {"t": ((time - origin) / ms).round(3).tolist(), "v": values.astype(np.float64).round(3).tolist()}


def drawn(
    time: Times, values: NDArray[Real], begin: int, end: int, columns: int
) -> tuple[Times, NDArray[Real]]:
    """Rows that draw the same picture: those of a column of pixels become their least and their greatest.

    Where nothing came for 250 ms there is a row of NaN, so that no line bridges it.

    >>> time, values = drawn(np.arange(8), np.array([0.0, 1, 9, 1, 0, 0, -5, 0]), 0, 7, 2)
    >>> time.tolist(), values.tolist()
    ([0, 3, 4, 7], [0.0, 9.0, -5.0, 0.0])

    Args:
        time: (n,) ns, increasing, from `begin` to `end`.
        values: (n, ...) each column on its own; NaN stays only where there is nothing else.
        begin: ns, the left edge of the picture.
        end: ns, its right edge.
        columns: Of pixels, in the picture.

    Returns:
        At most two rows for each column of pixels, and as many of NaN; all of fewer rows.
    """
    thinned = len(time) > 2 * columns
    if thinned:
        edges = np.linspace(0, end - begin, columns, endpoint=False)  # (columns,) ns after the left one
        starts = np.unique(np.searchsorted(time - begin, edges))  # rows, of the columns that have some
        starts = starts[starts < len(time)]
        ends = np.append(starts[1:], len(time)) - 1
        least, greatest = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
        time = np.stack((time[starts], time[ends]), axis=1).reshape(-1)
        values = np.stack((least, greatest), axis=1).reshape(-1, *values.shape[1:])
    after = np.diff(time)  # (rows - 1,) ns
    if thinned:
        after[::2] = 0  # from the first row of a column to its last, between which others came
    pauses = np.flatnonzero(after > PAUSE) + 1
    return np.insert(time, pauses, time[pauses - 1] + 1), np.insert(values, pauses, np.nan, axis=0)
