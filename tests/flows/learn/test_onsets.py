import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from flows.learn.onsets import match_onsets, runs
from operators import ms
from operators.batch import Flags


def test_the_first_onset_of_a_slip_gives_its_delay() -> None:
    found = match_onsets(np.array([20, 80, 90]) * ms, [(10 * ms, 100 * ms)])
    assert found.delays.tolist() == [10 * ms]
    assert (found.missed, found.false) == (0, 0)


def test_an_onset_may_be_a_little_early_or_ring_on() -> None:
    slips = [(1000 * ms, 1100 * ms)]
    for onset, caught in ((949, False), (950, True), (1250, True), (1251, False)):
        assert (match_onsets(np.array([onset * ms]), slips).missed == 0) == caught


@given(
    st.lists(st.integers(0, 5000), max_size=20).map(sorted),
    st.lists(st.integers(0, 5000), max_size=10, unique=True).map(sorted),
)
def test_every_slip_is_caught_or_missed(onsets: list[int], starts: list[int]) -> None:
    slips = [(start * ms, start * ms + ms) for start in starts]
    found = match_onsets(np.array(onsets, np.int64) * ms, slips)
    assert len(found.delays) + found.missed == len(slips)
    assert 0 <= found.false <= len(onsets)


@given(st.lists(st.booleans()).map(np.array))
def test_runs_cover_what_is_true_and_nothing_else(flags: Flags) -> None:
    covered = np.zeros(len(flags), np.bool_)
    for first, end in runs(flags == 1).tolist():
        assert not covered[max(first - 1, 0)], "runs do not touch"
        covered[first:end] = True
    assert np.array_equal(covered, flags)
