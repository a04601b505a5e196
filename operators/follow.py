"""Subtraction of a baseline that follows temperature and slow drift."""

from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from operators.batch import Counts, Flags, Reals, Times, Touch, Zeroed, s
from operators.chain import Chain
from operators.checks import check_above, check_at_least
from operators.errors import FingertipError
from operators.fingertip import Fingertip
from operators.operator import Operator
from operators.row_loop import nearest_count, row_loop

_GAIN: Final = 0.2  # share of a difference that the baseline follows per second
_FADE: Final = 120.0  # s, time constant of the slope
_SHARE: Final = 0.2  # of the deepest reading in a contact, by which the tolerance is larger after it
_CAP: Final = 20.0  # counts, at most
_RECOVERY: Final = 5.0  # counts above the baseline that may be recovery of the rubber after a contact
_RECOVERED: Final = 30.0  # s in air after which none of it is
_SIGNIFICANT: Final = 5.0  # standard errors from which on the first slope counts
_PAUSE: Final = 2 * s  # ns, longest time that the slope is extrapolated without a row
_READINGS: Final = 10  # least number of readings in a second
_PRIOR: Final = 100.0  # weight of the given temperature coefficient, squared counts of temperature
_SPREAD: Final = 0.5  # largest difference of the learned coefficient from the given one
_HYSTERESIS: Final = 0.75  # counts from which on the subtracted whole count changes


@dataclass
class Follow(Operator[Touch, Zeroed]):
    """Subtract a baseline that follows temperature and slow drift, also during contact.

    It starts as `Zero` does: the median of the first `scans` samples, which are delayed. Their slope is part
    of the baseline if they lie on a line that is steeper than their noise explains. Zeroed input passes
    unchanged.

    A second is unloaded if at least three quarters of the cells are quiet, and none of these is further below
    the baseline than the tolerance. Then these cells move the baseline and its temperature coefficient. The
    baseline always moves with the temperature column and with the first slope, which fades (120 s). So:

    - A press faster than `rate` leaves the tolerance, 5 s of `rate`, and stops the following. It is then
      preserved for any time. A slower press is followed like drift.
    - After a contact the tolerance is larger by a fifth of its deepest reading, at most 20 counts, so that
      the fingertip is recognised as unloaded again. A quiet load within it is followed like drift: do not
      reduce a grip to less than a fifth of its depth plus 5 s of `rate` without lifting.
    - Quiet counts above the baseline are no press. The baseline follows them if no cell is pressed, except
      for 5 counts that may be recovery of the rubber; this share falls to 0 within 30 s in air.

    Counts must fall as the pressure rises; `Pool(gain=-1)` turns others.

    Args:
        rate: Fastest drift that is followed without a temperature change, counts/s.
        temperature: Counts of pressure per count of temperature, as a start value; learned in air within
            0.5 of it. The default is that of the MPL115A2.
        quiet: Standard deviation below which a cell is quiet, counts.
        scans: Number of samples for the first baseline.

    Raises:
        ParameterError: if `rate` or `quiet` is not above 0, or `scans` is below 1.

    References:
        MPL115A2 datasheet, section 3.6: -(b2 + c12 P) / (b1 + c12 T) with the coefficients of its example.

    >>> cells = np.full((1, 6), 700, np.int16)
    >>> touch = Touch(np.zeros(1, int), cells, cells, cells > 0)
    >>> Follow(scans=1).push(touch).counts
    array([[0, 0, 0, 0, 0, 0]], dtype=int16)
    """

    rate: float = 0.3
    temperature: float = -0.3
    quiet: float = 1.0
    scans: int = 100
    _held: Chain[Touch] = field(default_factory=lambda: Chain(Touch), init=False, repr=False, compare=False)
    _state: Reals | None = field(default=None, init=False, repr=False, compare=False)  # (15, cells)
    _known: Flags = field(init=False, repr=False, compare=False)  # (cells,) cells with a baseline
    # ns: first row, start of the current second's sums
    _clock: Times = field(init=False, repr=False, compare=False)
    # (2,) growth of the tolerance by a contact, counts; time since then, s
    _contact: Reals = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_above("Follow", "rate", self.rate, 0, "counts/s")
        check_above("Follow", "quiet", self.quiet, 0, "counts")
        check_at_least("Follow", "scans", self.scans, 1, "sample")

    def output_fingertip(self, given: Fingertip) -> Fingertip:
        """Check that counts fall as the pressure rises, if the fingertip says so.

        Raises:
            FingertipError: if they rise.
        """
        if given.falls is False:
            fix = "insert Pool(gain=-1)"
            raise FingertipError("Follow", "counts that fall as pressure rises", "rising counts", fix)
        return given

    def process(self, batch: Touch) -> Zeroed:
        """Return the batch with the baseline subtracted, or delay it."""
        if isinstance(batch, Zeroed):
            return batch
        if self._state is not None:
            return self._subtract(batch, self._state)
        self._held.append(batch)
        return self._release() if len(self._held) >= self.scans else Zeroed.empty()

    def flush(self) -> Zeroed:
        """Return the delayed samples, zeroed with their own baseline."""
        return self._release() if len(self._held) else Zeroed.empty()

    def _release(self) -> Zeroed:
        held = self._held.take()
        first = held[: self.scans]
        self._known = np.any(first.valid, axis=0)
        self._clock, self._contact = np.array([first.time[0]] * 2), np.array([0.0, _RECOVERED])
        self._state = np.zeros((_ROWS, held.cells))
        self._state[_PER_DEGREE] = self.temperature
        for cell in np.flatnonzero(self._known):
            rows = first.valid[:, cell]
            level, slope = _line(first.time[rows] - first.time[0], first.counts[rows, cell], self.quiet)
            self._state[_LEVEL, cell], self._state[_SLOPE, cell] = level, slope
            self._state[[_REFERENCE, _WARMTH], cell] = np.mean(first.temperature[rows, cell])
        self._state[_OFFSET] = np.rint(self._state[_LEVEL])
        return self._subtract(held, self._state)

    def _subtract(self, batch: Touch, state: Reals) -> Zeroed:
        counts, known = np.empty(batch.counts.shape, np.int16), self._known
        limits = float(self.rate), float(self.temperature), float(self.quiet)
        columns = batch.time, batch.counts, batch.temperature, batch.valid
        _follow(*columns, (state, known, self._clock, self._contact), limits, counts)
        return Zeroed(batch.time, counts, batch.temperature, batch.valid & known, finger=batch.finger)


def _line(time: Times, counts: Counts, quiet: float) -> tuple[float, float]:
    """Return start and slope (counts/s) of readings at `time` (ns); median and 0 if they are no line."""
    at = (time - time.mean()) / s
    spread = float(np.sum(at * at))
    level = float(np.median(counts))
    if len(counts) < _READINGS or not spread:
        return level, 0.0
    slope = float(np.sum(at * counts) / spread)
    scatter = float(np.std(counts - slope * at))
    if scatter >= quiet or abs(slope) <= _SIGNIFICANT * scatter / spread**0.5:
        return level, 0.0
    return float(np.mean(counts)) + slope * float(at[0] - time[0] / s), slope


# Rows of the state: baseline without temperature, its slope (counts/s), subtracted whole count; counts per
# count of temperature, temperature of the first baseline and of the last second; of the line of baseline over
# temperature: seconds, means, sums of squares and products; of the current second: readings, sum and
# sum of squares of their differences from the baseline, sum of their temperatures.
_LEVEL, _SLOPE, _OFFSET, _PER_DEGREE, _REFERENCE, _WARMTH = range(6)
_SECONDS, _MEAN_X, _MEAN_Y, _SQUARED, _PRODUCT = range(6, 11)
_NUMBER, _SUM, _SQUARES, _TEMPERATURES, _ROWS = range(11, 16)
Memory: TypeAlias = tuple[Reals, Flags, Times, Reals]  # state, known, clock, contact
Limits: TypeAlias = tuple[float, float, float]  # rate, temperature, quiet


@row_loop
def _follow(  # noqa: PLR0917 - compiled functions take no keywords
    time: Times,
    counts: Counts,
    temperature: Counts,
    valid: Flags,
    /,
    memory: Memory,
    limits: Limits,
    zeroed: Counts,
) -> None:
    """Write the counts relative to the baseline."""
    state, known, clock, _ = memory
    for row in range(len(time)):
        if (time[row] - clock[0]) // s != (clock[1] - clock[0]) // s:
            _end_second(memory, limits, min(time[row] - clock[1], _PAUSE) / s)
            clock[1] = time[row]
        since = min(time[row] - clock[1], _PAUSE) / s
        for cell in range(counts.shape[1]):
            warmed = state[_PER_DEGREE, cell] * (state[_WARMTH, cell] - state[_REFERENCE, cell])
            baseline = state[_LEVEL, cell] + state[_SLOPE, cell] * since + warmed
            if abs(baseline - state[_OFFSET, cell]) > _HYSTERESIS:
                state[_OFFSET, cell] = nearest_count(baseline)
            zeroed[row, cell] = nearest_count(float(counts[row, cell]) - state[_OFFSET, cell])
            if valid[row, cell] and known[cell]:
                difference = float(counts[row, cell]) - baseline
                state[_NUMBER, cell] += 1.0
                state[_SUM, cell] += difference
                state[_SQUARES, cell] += difference * difference
                state[_TEMPERATURES, cell] += float(temperature[row, cell])


def _end_second(memory: Memory, limits: Limits, elapsed: float) -> None:
    """Move the baseline by the second that ends, `elapsed` s long, and clear its sums."""
    state, _, _, contact = memory
    rate, start, quiet = limits
    reach = rate / _GAIN
    tolerance = reach + contact[0]
    recovery = _RECOVERY * (1.0 - contact[1] / _RECOVERED)
    measured = calm = near = 0
    deepest = 0.0
    for cell in range(state.shape[1]):
        if state[_NUMBER, cell] >= _READINGS:
            measured += 1
            calm += _is_quiet(state, cell, quiet)
            near += _is_unloaded(state, cell, quiet, tolerance)
            deepest = max(deepest, -state[_SUM, cell] / state[_NUMBER, cell])
    unloaded = measured > 0 and 4 * calm >= 3 * measured and near == calm
    whole = near == measured
    for cell in range(state.shape[1]):
        state[_LEVEL, cell] += state[_SLOPE, cell] * elapsed
        state[_SLOPE, cell] *= 1.0 - min(elapsed / _FADE, 1.0)
        if state[_NUMBER, cell] > 0:
            state[_WARMTH, cell] = state[_TEMPERATURES, cell] / state[_NUMBER, cell]
        if unloaded and _is_unloaded(state, cell, quiet, tolerance):
            _correct(state, cell, reach, recovery, whole)
            if whole:
                _learn_temperature(state, cell, start)
        state[_NUMBER:, cell] = 0.0
    if unloaded:
        contact[0] *= 1.0 - _GAIN
        contact[1] = min(contact[1] + elapsed, _RECOVERED)
    else:
        contact[0] = max(contact[0], min(_SHARE * deepest, _CAP))
        contact[1] = 0.0


def _is_quiet(state: Reals, cell: int, quiet: float) -> bool:
    """Return whether the standard deviation of the current second is below `quiet`."""
    number, total = state[_NUMBER, cell], state[_SUM, cell]
    result: bool = number * state[_SQUARES, cell] - total * total < quiet * quiet * number * number
    return result


def _is_unloaded(state: Reals, cell: int, quiet: float, tolerance: float) -> bool:
    """Return whether a cell was quiet in the current second, and no further below the baseline."""
    number = state[_NUMBER, cell]
    near: bool = number >= _READINGS and state[_SUM, cell] >= -tolerance * number
    return near and _is_quiet(state, cell, quiet)


def _correct(state: Reals, cell: int, reach: float, recovery: float, whole: bool) -> None:  # noqa: FBT001 - loop
    """Move the baseline of an unloaded cell: within `reach`; beyond only if the `whole` tip is unloaded."""
    mean = state[_SUM, cell] / state[_NUMBER, cell]
    mean -= min(max(mean, 0.0), recovery)
    if whole or abs(mean) <= reach:
        state[_LEVEL, cell] += _GAIN * mean


def _learn_temperature(state: Reals, cell: int, start: float) -> None:
    """Fit a line of baseline over temperature; the baseline stays the same at this temperature."""
    warmer = state[_WARMTH, cell] - state[_REFERENCE, cell]
    baseline = state[_LEVEL, cell] + state[_PER_DEGREE, cell] * warmer
    state[_SECONDS, cell] += 1.0
    away = warmer - state[_MEAN_X, cell]
    state[_MEAN_X, cell] += away / state[_SECONDS, cell]
    rest = baseline - start * warmer - state[_MEAN_Y, cell]
    state[_MEAN_Y, cell] += rest / state[_SECONDS, cell]
    state[_SQUARED, cell] += away * (warmer - state[_MEAN_X, cell])
    state[_PRODUCT, cell] += (warmer - state[_MEAN_X, cell]) * rest
    change = state[_PRODUCT, cell] / (state[_SQUARED, cell] + _PRIOR)
    state[_PER_DEGREE, cell] = start + min(max(change, -_SPREAD), _SPREAD)
    state[_LEVEL, cell] = baseline - state[_PER_DEGREE, cell] * warmer
