from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators import Align, Label, SlidingMotion, Truth, Zeroed, ms
from operators.batch import Codes, Reals, Times

PERIOD = 10 * ms


def truth(sliding: Reals, start: int = 0) -> Truth:
    rows = len(sliding)
    return Truth(start + np.arange(rows) * PERIOD, sliding, np.ones(rows), np.zeros((rows, 3)))


def touch(time: Times) -> Zeroed:
    cells = np.zeros((len(time), 6), np.int16)
    return Zeroed(time, cells, cells, cells == 0)


def labels(rows: Truth, samples: Zeroed) -> Codes:
    """Label samples by true sliding, as a flow does."""
    align, label = Align(wait=200 * ms), Label()
    return label.push(align.push(samples, SlidingMotion().push(rows))).label


def test_a_sample_is_slip_while_the_contact_slides_at_its_instant() -> None:
    rows = truth(np.repeat([0.0, 0.004, 0.002], 40))
    assert labels(rows, touch(rows.time))[:80].tolist() == [0] * 40 + [1] * 40


@pytest.mark.parametrize(("static", "speed"), [(14, 0.05), (15, 0.0)])
def test_a_stick_of_up_to_150_ms_between_two_slides_is_part_of_the_slip(static: int, speed: float) -> None:
    sliding = np.zeros(100)
    sliding[20:30] = sliding[30 + static : 50 + static] = 0.05
    found = SlidingMotion().push(truth(sliding)).velocity[:, 0]
    stick = slice(30, 30 + static)
    assert set(found[stick]) == {speed}
    assert np.delete(found, stick).tolist() == np.delete(sliding, stick).tolist()


def test_the_rows_of_a_possible_stick_come_when_it_is_over() -> None:
    operator = SlidingMotion()
    assert len(operator.push(truth(np.array([0.0, 0.05])))) == 2
    assert len(operator.push(truth(np.zeros(15), start=2 * PERIOD))) == 0
    assert len(operator.push(truth(np.zeros(1), start=17 * PERIOD))) == 16
    again = operator.reset_copy()
    again.push(truth(np.array([0.05, 0.0])))
    assert again.flush().velocity[:, 0].tolist() == [0.0]


def test_samples_without_truth_are_unknown() -> None:
    rows = truth(np.full(40, 0.05), start=100 * PERIOD)
    found = labels(rows, touch(np.arange(140) * PERIOD))
    assert (found[:90] == -1).all()
    assert (found[100:] == 1).all()


@given(st.lists(st.sampled_from([0.0, 0.003, 0.004, 0.1]), max_size=60), st.integers(0, 300))
def test_slips_are_those_of_the_reference(speeds: list[float], stick: int) -> None:
    rows = truth(np.array(speeds))
    operator = SlidingMotion(stick=stick * ms)
    found = np.concatenate([operator.push(rows).velocity[:, 0], operator.flush().velocity[:, 0]]) > 0.003
    slides = [row for row, speed in enumerate(speeds) if speed > 0.003]
    slips = [pair for pair in pairwise(slides) if (pair[1] - pair[0]) * PERIOD <= stick * ms]
    expected = [
        row in slides or any(first <= row <= last for first, last in slips) for row in range(len(speeds))
    ]
    assert found.tolist() == expected
