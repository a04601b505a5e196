"""What a page shows of a stream's rows, and how it is written down as JSON."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.batch import Motion, Reals, Scores, Times, Touch, ms
from operators.ports import Json

Real = TypeVar("Real", bound=np.floating[Any])


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


def extremes(time: Times, values: NDArray[Real], points: int) -> tuple[Times, NDArray[Real]]:
    """At most `points` rows that draw the same picture: the least and the greatest of equally many rows each.

    >>> time, values = extremes(np.arange(8), np.array([0.0, 1, 9, 1, 0, 0, -5, 0]), 4)
    >>> time.tolist(), values.tolist()
    ([0, 3, 4, 7], [0.0, 9.0, -5.0, 0.0])

    Args:
        time: (n,) ns.
        values: (n, ...) each column on its own; NaN stays only where there is nothing else.
        points: an even number.
    """
    if len(time) <= points:
        return time, values
    starts = np.linspace(0, len(time), points // 2, endpoint=False).astype(np.intp)  # (points / 2,)
    ends = np.append(starts[1:], len(time)) - 1
    least = np.fmin.reduceat(values, starts)  # (points / 2, ...)
    greatest = np.fmax.reduceat(values, starts)
    return (
        np.stack((time[starts], time[ends]), axis=1).reshape(-1),
        np.stack((least, greatest), axis=1).reshape(-1, *values.shape[1:]),
    )
