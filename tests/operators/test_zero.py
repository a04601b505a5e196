from math import inf

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from operators import Touch, Zero, Zeroed, concat, ms
from operators.batch import Counts, Flags

CELLS = 4  # of the drawn touch; each number needs a program of its own, which takes seconds to compile
readings = st.integers(1, 12).flatmap(
    lambda rows: st.tuples(
        arrays(np.int16, (rows, CELLS), elements=st.integers(-(2**15), 2**15 - 1)),
        arrays(bool, (rows, CELLS)),
    )
)


def _touch(counts: list[int]) -> Touch:
    """Rows in each of which all cells read the same."""
    return Touch.rows(range(len(counts)), np.repeat(np.array(counts)[:, None], 6, axis=1), 9, True)


@given(readings=readings, scans=st.integers(1, 8))
def test_the_baseline_is_the_median_of_first_readings(readings: tuple[Counts, Flags], scans: int) -> None:
    """They are held back; a median between two counts is rounded half to even; 16 bits limit a difference."""
    counts, valid = readings
    touch = Touch.rows(np.arange(len(counts)) * 10 * ms, counts, counts, valid, finger=1)
    zero = Zero(scans=scans, spike=inf)
    assert not len(zero.push(touch[: scans - 1]))
    zeroed = concat(Zeroed, [zero.push(touch[scans - 1 :]), zero.flush()])
    assert (zeroed.time.tolist(), zeroed.finger) == (touch.time.tolist(), 1)
    np.testing.assert_array_equal(zeroed.temperature, counts)
    for cell, answered in enumerate(valid.T):
        first = counts[:scans, cell][answered[:scans]]
        assert zeroed.valid[:, cell].tolist() == (answered & bool(len(first))).tolist()
        known = zeroed.valid[:, cell]
        level = round(float(np.median(first))) if len(first) else 0
        expected = np.clip(counts[known, cell].astype(int) - level, -(2**15), 2**15 - 1)
        assert zeroed.counts[known, cell].tolist() == expected.tolist()


def test_a_given_baseline_is_subtracted_at_once() -> None:
    assert Zero(500).push(_touch([400])).counts[0].tolist() == [-100] * 6
    by_cell = Zero((0, 1, 2, 3, 4, 1023)).push(_touch([400]))
    assert by_cell.counts[0].tolist() == [400, 399, 398, 397, 396, -623]
    assert Zero(-20_000).push(_touch([32_000, -32_000])).counts[:, 0].tolist() == [32_767, -12_000]
    for zero in (Zero(650), Zero((650,) * 4)):
        assert zero.push(Touch.rows([0], [[700] * 4], 0, True)).counts.tolist() == [[50] * 4]


def test_zeroed_input_passes_unchanged() -> None:
    touch = _touch([600, 601])
    zeroed = Zeroed(touch.time, touch.counts, touch.temperature, touch.valid)
    np.testing.assert_array_equal(Zero(scans=2).push(zeroed).packed, zeroed.packed)
