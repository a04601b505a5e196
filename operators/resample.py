"""Conversion of the rate of a touch stream."""

from dataclasses import dataclass, field, replace

import numpy as np

from operators.batch import Counts, Flags, Reals, Times, Touch, Zeroed, ms, s
from operators.checks import check_above, check_between
from operators.fingertip import Fingertip
from operators.operator import Operator
from operators.row_loop import nearest_count, row_loop

_FASTEST = 1e6  # Hz


@dataclass
class Resample(Operator[Touch, Touch]):
    """Convert touch to a constant rate: each output row is the mean of the input over the period before it.

    Between two input rows the signal is a straight line. The mean over a period (a moving average)
    suppresses frequencies that would alias at the new rate; the same rule increases a rate.
    Output times are multiples of the period since 1970, whatever the start. A row follows as soon as an input
    row at or after its time arrives.

    A line ends at a row in which the cell is invalid, and at a gap. A cell is valid if lines cover at least
    half of the period; a period of which the input covers less than half gives no row. Temperatures are those
    of the newest input row. Zeroed input gives zeroed output.

    Args:
        rate: Rows per second, Hz.
        gap: Longest distance between input rows that a line bridges, ns.

    Raises:
        ParameterError: if the rate is not above 0 and at most 1 MHz, or the gap is not above 0.

    >>> time = np.arange(0, 41) * ms
    >>> ramp = np.arange(0, 41, dtype=np.int16)[:, None]
    >>> slow = Resample(rate=100).push(Touch(time, ramp, 0 * ramp, ramp >= 0))
    >>> slow.time // ms, slow.counts.ravel()
    (array([10, 20, 30, 40]), array([ 5, 15, 25, 35], dtype=int16))
    """

    rate: float = 100.0
    gap: int = 200 * ms
    # time of the newest row and of the next output row, ns; ns of the current period that the input covers
    _clock: Times | None = field(default=None, init=False, repr=False, compare=False)
    _sums: Reals = field(init=False, repr=False, compare=False)  # (3, cells): see `_resample`
    _whole: Flags = field(init=False, repr=False, compare=False)  # (cells,) newest row is valid

    def __post_init__(self) -> None:
        check_above("Resample", "rate", self.rate, 0, "Hz")
        check_between("Resample", "rate", self.rate, 0, _FASTEST, unit="Hz")
        check_above("Resample", "gap", self.gap, 0, "ns")
        self._sums, self._whole = np.zeros((3, 0)), np.zeros(0, np.bool_)

    def output_fingertip(self, given: Fingertip) -> Fingertip:
        """Return the fingertip at the new rate."""
        return replace(given, rate=float(self.rate))

    def process(self, batch: Touch) -> Touch:
        """Return the rows whose periods end within the batch."""
        period, time = round(s / self.rate), batch.time
        if self._clock is None:
            self._clock = np.array([time[0], _next(int(time[0]), period), 0])
            self._sums = np.zeros((3, batch.cells))
            self._whole = np.zeros(batch.cells, np.bool_)
        longest = (int(time[-1]) - int(self._clock[1])) // period + 1
        most = max(min(longest, len(time) * (self.gap // period + 1)), 0)
        at, shape = np.empty(most, np.int64), (most, batch.cells)
        counts, temperature, valid = (
            np.empty(shape, np.int16),
            np.empty(shape, np.int16),
            np.empty(shape, np.bool_),
        )
        limits = period, self.gap
        columns = time, batch.counts, batch.temperature, batch.valid
        made = _resample(
            *columns, limits, self._clock, self._sums, self._whole, at, counts, temperature, valid
        )
        kind = Zeroed if isinstance(batch, Zeroed) else Touch
        return kind(at[:made], counts[:made], temperature[:made], valid[:made], finger=batch.finger)


def _next(time: int, period: int) -> int:
    """Return the first multiple of the period after a time (ns)."""
    return (time // period + 1) * period


_NEWEST, _DUE, _COVERED = range(3)  # of the clock
_VALUE, _AREA, _SPAN = range(3)  # of the sums: newest counts; counts * ns and ns of the current period


@row_loop
def _resample(
    time: Times,
    counts: Counts,
    temperature: Counts,
    valid: Flags,
    /,
    limits: tuple[int, int],
    clock: Times,
    sums: Reals,
    whole: Flags,
    at: Times,
    means: Counts,
    warmth: Counts,
    known: Flags,
) -> int:
    """Write time, counts, temperature and validity of each output row, and return their number."""
    period, gap = limits
    made = 0
    for row in range(len(time)):
        end = time[row]
        if end - clock[_NEWEST] > gap:  # no line: drop the period
            clock[_NEWEST], clock[_DUE], clock[_COVERED] = end, _next(end, period), 0
            sums[_AREA:] = 0.0
            whole[:] = False
        while clock[_NEWEST] < end:
            start, until = clock[_NEWEST], min(end, clock[_DUE])
            share = (until - start) / (end - start)
            for cell in range(counts.shape[1]):
                if whole[cell] and valid[row, cell]:
                    before = sums[_VALUE, cell]
                    value = before + (float(counts[row, cell]) - before) * share
                    sums[_AREA, cell] += (before + value) * 0.5 * (until - start)
                    sums[_SPAN, cell] += until - start
                    sums[_VALUE, cell] = value
            clock[_NEWEST] = until
            clock[_COVERED] += until - start
            if until == clock[_DUE]:
                if 2 * clock[_COVERED] >= period:
                    at[made] = until
                    for cell in range(counts.shape[1]):
                        span = sums[_SPAN, cell]
                        means[made, cell] = nearest_count(sums[_AREA, cell] / span if span > 0.0 else 0.0)
                        known[made, cell] = 2.0 * span >= period
                        warmth[made, cell] = temperature[row, cell]
                    made += 1
                clock[_DUE], clock[_COVERED] = until + period, 0
                sums[_AREA:] = 0.0
        for cell in range(counts.shape[1]):
            sums[_VALUE, cell] = float(counts[row, cell])
            whole[cell] = valid[row, cell]
    return made
