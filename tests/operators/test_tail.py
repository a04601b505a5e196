import pickle

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators import Batch, Scores, Slips
from operators.tail import Tail


def _scores(first: int, rows: int) -> Scores:
    return Scores(np.arange(first, first + rows), np.arange(first, first + rows) / 4, finger=3)


@given(pushes=st.lists(st.tuples(st.sampled_from([1, 5, 300, 1500]), st.integers(0, 40)), max_size=40))
def test_rows_keep_their_order_and_views_remain_valid(
    pushes: list[tuple[int, int]],
) -> None:
    tail, newest = Tail(Scores), 0
    given: list[tuple[Scores, int]] = []
    for rows, kept in pushes:
        tail.append(_scores(newest, rows))
        newest += rows
        tail.drop(max(0, len(tail) - kept))
        given.append((tail.rows, newest))
    for scores, newest in given:
        expected = _scores(newest - len(scores), len(scores))
        np.testing.assert_array_equal(scores.time, expected.time)
        np.testing.assert_array_equal(scores.probability, expected.probability)
        assert scores.finger == 3


def test_its_memory_is_bounded_by_the_rows_kept_and_the_largest_batch() -> None:
    tail = Tail(Batch)
    for size in (1, 100_000, 1, 1):
        tail.append(Batch(np.zeros(size, np.int64)))
        tail.drop(len(tail) - 1)
    assert len(tail.block) < 2000
    for _ in range(10_000):
        tail.append(Batch(np.zeros(7, np.int64)))
        tail.drop(7)
    assert len(tail.block) < 2000


def test_a_pickle_holds_only_the_rows_in_use_and_resumes() -> None:
    tail = Tail(Scores)
    tail.append(_scores(0, 900))
    tail.drop(895)
    pickled = pickle.dumps(tail)
    assert len(pickled) < 1000
    again = pickle.loads(pickled)  # noqa: S301 our own bytes
    again.append(_scores(900, 2))
    assert again.rows.time.tolist() == [895, 896, 897, 898, 899, 900, 901]


def test_columns_that_the_kind_lacks_fall_away() -> None:
    tail = Tail(Batch)
    tail.append(Slips(np.arange(3), np.zeros(3, np.int8), np.arange(3), np.zeros(3)))
    assert type(tail.rows) is Batch
    assert tail.time.tolist() == [0, 1, 2]
