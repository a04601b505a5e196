"""One bad reading is not a slip: single readings that are wrong become invalid, all others stay."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators import SLIP, Score, Touch, Zero, Zeroed, concat, ms
from operators.batch import Counts
from storage import load_debounce, load_detector

ROWS, CELLS = 300, 6
CASE = Path(__file__).parents[2] / ".." / "shared" / "cases" / "one_bit_error" / "bits_quiet.csv.gz"
seeds, places = st.integers(0, 2**32 - 1), st.integers(50, ROWS - 2)


def quiet(seed: int = 0, cells: int = CELLS) -> Counts:
    """A still fingertip that is pressed after a second, (n, cells)."""
    load = np.where(np.arange(ROWS) < 100, 520, 460)[:, None]
    return np.rint(np.random.default_rng(seed).normal(load, 0.6, (ROWS, cells))).astype(np.int16)


def zeroed(counts: Counts, zero: Zero | None = None, cut: int = ROWS) -> Zeroed:
    zero = Zero() if zero is None else zero
    touch = Touch(np.arange(len(counts)) * 10 * ms, counts, counts, np.ones(counts.shape, np.bool_))
    rows = [zero.push(touch[start : start + cut]) for start in range(0, len(counts), cut)]
    return concat(Zeroed, [*rows, zero.flush()])


def wrong(counts: Counts, row: int, cell: int, bit: int) -> Counts:
    """Counts with one wrong bit."""
    changed = counts.copy()
    changed.view(np.uint16)[row, cell] ^= 1 << bit
    return changed


@given(
    seed=seeds,
    row=places.filter(lambda row: not 98 <= row < 170),  # a press may hide it, until it is forgotten
    cells=st.sampled_from([2, CELLS, 16]),  # each number is compiled for
    cell=st.integers(0, 15),
    bit=st.integers(5, 15),
    cut=st.sampled_from([1, 7, ROWS]),
)
def test_a_wrong_bit_makes_that_cell_invalid_in_that_row_alone(
    seed: int, row: int, cells: int, cell: int, bit: int, cut: int
) -> None:
    counts, cell = quiet(seed, cells), cell % cells
    found = zeroed(wrong(counts, row, cell, bit), cut=cut)
    assert np.argwhere(~found.valid).tolist() == [[row, cell]]
    known = np.ones(found.valid.shape, np.bool_)
    known[row, cell] = False
    np.testing.assert_array_equal(found.counts[known], zeroed(counts).counts[known])
    again = concat(Zeroed, [(twice := Zero()).push(found), twice.flush()])
    np.testing.assert_array_equal(again.valid, found.valid)


@given(
    seed=seeds,
    row=places,
    jumps=st.lists(st.integers(-400, 400), min_size=CELLS, max_size=CELLS),
    last=st.sampled_from([0.0, 0.7, 1.0]),
)
def test_what_lasts_or_moves_other_cells_is_kept(seed: int, row: int, jumps: list[int], last: float) -> None:
    """A blow of one row in several cells; steps and decays in any number of cells."""
    counts, jump = quiet(seed), np.array(jumps)
    if not last:  # a blow: another cell has at least half of the largest deviation
        jump[1] = np.abs(jump).max() if abs(jump[1]) < np.abs(jump).max() else jump[1]
        jump[0] = jump[1] * 2 // 3
    tail = last ** np.arange(ROWS - row)[:, None]
    counts[row:] += np.rint(jump * tail).astype(np.int16)
    assert zeroed(counts).valid.all()


def test_a_row_is_delayed_by_one_sample_at_most_and_only_if_it_is_suspicious() -> None:
    counts = wrong(wrong(quiet(), 200, 3, 7), 220, 1, 9)
    zero, late = Zero(500), list[int]()
    touch = Touch(np.arange(ROWS) * 10 * ms, counts, counts, np.ones(counts.shape, np.bool_))
    for row in range(150, ROWS):
        given_rows = zero.push(touch[row : row + 1])
        if len(given_rows) != 1:
            late.append(row)
    assert late[:2] == [200, 201]
    assert set(late) >= {200, 201, 220, 221}
    assert len(late) < 10


def test_a_single_cell_and_an_infinite_limit_test_nothing() -> None:
    counts = wrong(quiet(), 200, 3, 9)
    assert zeroed(counts, Zero(spike=np.inf)).valid.all()
    assert zeroed(counts[:, 3:4]).valid.all()


def onsets(counts: Counts, zero: Zero | None = None) -> int:
    slips = load_debounce("psd").push(Score(load_detector("psd")).push(zeroed(counts, zero)))
    return int((slips.state == SLIP).sum())


def test_the_errors_of_the_recorded_case_are_no_slip() -> None:
    if not CASE.exists():
        pytest.skip(f"no case at {CASE}")
    counts = np.loadtxt(CASE, delimiter=",", skiprows=1, dtype=np.int16)[:, 1:]
    assert onsets(counts, Zero(spike=np.inf)) - onsets(counts) == 25
