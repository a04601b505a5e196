import numpy as np
import pytest

from operators import Touch, Zero, Zeroed, ms
from operators.batch import Flags


def _touch(counts: list[int], valid: Flags | None = None, start: int = 0) -> Touch:
    """Rows 10 ms apart, in each of which all cells read the same."""
    rows = np.repeat(np.array(counts, np.int16)[:, None], 6, axis=1)
    valid = np.ones(rows.shape, np.bool_) if valid is None else valid
    time = (start + np.arange(len(rows))) * 10 * ms
    return Touch(time, rows, rows + np.int16(9), valid, finger=1)


def test_the_first_scans_are_held_back_until_their_median_is_known() -> None:
    zero = Zero(scans=3)
    assert len(zero.push(_touch([600, 640]))) == 0
    zeroed = zero.push(_touch([601, 700], start=2))
    assert zeroed.counts[:, 0].tolist() == [-1, 39, 0, 99]
    assert zeroed.time.tolist() == [0, 10 * ms, 20 * ms, 30 * ms]
    assert zeroed.temperature[:, 0].tolist() == [609, 649, 610, 709]
    assert zeroed.finger == 1
    assert zero.push(_touch([500], start=4)).counts[0].tolist() == [-101] * 6


@pytest.mark.parametrize(("counts", "baseline"), [([600, 601], 600), ([601, 602], 602), ([5, 9], 7)])
def test_a_median_between_two_counts_is_rounded_half_to_even(counts: list[int], baseline: int) -> None:
    assert Zero(scans=2).push(_touch(counts)).counts[0, 0] == counts[0] - baseline


def test_only_valid_readings_make_the_baseline_and_a_cell_that_never_answered_stays_invalid() -> None:
    valid = np.ones((3, 6), np.bool_)
    valid[1:, 2] = valid[:, 4] = False
    zero = Zero(scans=3)
    assert zero.push(_touch([600, 0, 0], valid)).counts[0, valid[0]].tolist() == [600, 600, 0, 600, 600]
    assert zero.push(_touch([600], start=3)).valid[0].tolist() == [True] * 4 + [False, True]


def test_a_short_stream_is_zeroed_with_its_own_median_at_the_end() -> None:
    zero = Zero()
    zero.push(_touch([600, 610, 620]))
    assert zero.flush().counts[:, 0].tolist() == [-10, 0, 10]
    assert len(zero.flush()) == 0


def test_a_given_baseline_is_subtracted_at_once() -> None:
    assert Zero(500).push(_touch([400])).counts[0].tolist() == [-100] * 6
    by_cell = Zero((0, 1, 2, 3, 4, 1023)).push(_touch([400]))
    assert by_cell.counts[0].tolist() == [400, 399, 398, 397, 396, -623]


def test_zeroed_input_passes_unchanged() -> None:
    touch = _touch([600, 601])
    zeroed = Zeroed(touch.time, touch.counts, touch.temperature, touch.valid)
    np.testing.assert_array_equal(Zero(scans=2).push(zeroed).packed, zeroed.packed)


def test_the_number_of_cells_comes_from_the_batch() -> None:
    cells = np.full((3, 4), 700, np.int16)
    touch = Touch(np.arange(3), cells, cells, cells > 0)
    for zero in (Zero(650), Zero((650, 650, 650, 650))):
        assert (zero.push(touch).counts == 50).all()
    assert (Zero(scans=2).push(touch).counts == 0).all()


def test_a_difference_beyond_16_bits_is_limited_and_keeps_its_sign() -> None:
    assert Zero(-20_000).push(_touch([32_000, -32_000])).counts[:, 0].tolist() == [32_767, -12_000]
