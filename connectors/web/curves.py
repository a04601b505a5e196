"""Curves of a page: plotted values, reduction to pixel columns, and JSON."""

from collections.abc import Iterable, Mapping
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from connectors.events import Fault, Slip, finger_name, quality
from operators.batch import Motion, Reals, Scores, Times, Touch, ms
from operators.ports import Json

Real = TypeVar("Real", bound=np.floating[Any])
GAP: Final = 250 * ms  # ns; a longer pause is drawn as a gap, as in rows.js


def plotted(batch: Touch | Motion | Scores) -> tuple[str, Reals]:
    """Return the name of a batch's curve, and its plotted values.

    >>> plotted(Scores(np.array([5]), np.array([0.5]), finger=2))
    ('scores 2', array([0.5]))

    Returns:
        Stream and fingertip, and (n, cells) counts of ``touch``, NaN for invalid cells; (n,) TCP speed of
        ``speed``, mm/s; or (n,) probability of ``scores``.
    """
    finger = finger_name(batch.finger)
    if isinstance(batch, Touch):
        return f"touch {finger}", np.where(batch.valid, batch.counts, np.nan)
    if isinstance(batch, Motion):
        return f"speed {finger}", 1000 * np.sqrt(np.square(batch.velocity[:, :3]).sum(axis=1))
    return f"scores {finger}", batch.probability


def join_rows(parts: Iterable[tuple[Times, NDArray[Any]]]) -> tuple[Times, NDArray[Any]]:
    """Join the rows of batches in order of time; late rows have arrived after newer ones."""
    times, values = zip(*parts, strict=True)
    time = np.concatenate(times)
    order = time.argsort(kind="stable")
    return time[order], np.concatenate(values)[order]


def curve_json(time: Times, values: NDArray[np.floating[Any]], origin: int) -> dict[str, Json]:
    """Return rows as JSON: times in ms since `origin` (ns), values rounded to 3 decimals.

    >>> curve_json(np.array([1_500_000, 2_000_000]), np.array([0.12345, 1.0]), 1_000_000)
    {'t': [0.5, 1.0], 'v': [0.123, 1.0]}
    """
    return {"t": ((time - origin) / ms).round(3).tolist(), "v": values.astype(np.float64).round(3).tolist()}


def faults_json(faults: Mapping[str, Iterable[Fault]]) -> dict[str, Json]:
    """Return current faults, by fingertip, as kinds by cell.

    >>> faults_json({"0": [Fault(4, "stuck")], "1": []})
    {'0': {'4': 'stuck'}}
    """
    return {
        finger: {str(fault.barometer): fault.kind for fault in found}
        for finger, found in faults.items()
        if found
    }


def event_json(
    number: int,
    finger: str,
    slip: Slip,
    origin: int,
    *,
    latency: int | None = None,
    faults: Iterable[Fault] = (),
) -> dict[str, Json]:
    """Return a slip event as JSON, with its time since `origin` (ns).

    `latency` (ns) is the time from the deciding sample to the arrival of the event, None: unknown; `faults`
    are those of the fingertip at the time of the event.
    """
    return {
        "id": number,
        "t": (slip.time - origin) / ms,
        "finger": finger,
        "onset": slip.onset,
        "p": round(slip.probability, 3),
        "quality": quality(slip.probability, faults),
        "latency": None if latency is None else round(latency / ms, 3),
    }


def thin_curve(
    time: Times, values: NDArray[Real], begin: int, end: int, columns: int
) -> tuple[Times, NDArray[Real]]:
    """Reduce rows to the minimum and maximum of each pixel column, without visible change.

    A row of NaN is inserted in each pause of more than 250 ms, so that no line crosses it.

    >>> time, values = thin_curve(np.arange(8), np.array([0.0, 1, 9, 1, 0, 0, -5, 0]), 0, 7, 2)
    >>> time.tolist(), values.tolist()
    ([0, 3, 4, 7], [0.0, 9.0, -5.0, 0.0])

    Args:
        time: (n,) ns, increasing, from `begin` to `end`.
        values: (n, ...); each component is reduced separately; NaN remains only if all values are NaN.
        begin: Left edge of the picture, ns.
        end: Right edge of the picture, ns.
        columns: Width of the picture, pixels.

    Returns:
        At most two rows per pixel column, or all rows if they are fewer, plus the rows of NaN.
    """
    thinned = len(time) > 2 * columns
    if thinned:
        edges = np.linspace(0, end - begin, columns, endpoint=False)  # (columns,) ns since `begin`
        starts = np.unique(np.searchsorted(time - begin, edges))  # first row of each column that has one
        starts = starts[starts < len(time)]
        ends = np.append(starts[1:], len(time)) - 1
        least, greatest = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
        time = np.stack((time[starts], time[ends]), axis=1).reshape(-1)
        values = np.stack((least, greatest), axis=1).reshape(-1, *values.shape[1:])
    pauses = np.diff(time)  # (rows - 1,) ns
    if thinned:
        pauses[::2] = 0  # between the two rows of a column
    gaps = np.flatnonzero(pauses > GAP) + 1
    return np.insert(time, gaps, time[gaps - 1] + 1), np.insert(values, gaps, np.nan, axis=0)
