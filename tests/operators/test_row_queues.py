import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators import Batch, Scores
from operators.row_queues import Tail


def _numbered(first: int, rows: int) -> Scores:
    return Scores(np.arange(first, first + rows), np.arange(first, first + rows) / 4, finger=3)


@given(pushes=st.lists(st.tuples(st.sampled_from([1, 5, 300, 1500]), st.integers(0, 40)), max_size=40))
def test_rows_keep_their_order_and_views_remain_valid(
    pushes: list[tuple[int, int]],
) -> None:
    tail, newest = Tail(Scores), 0
    given: list[tuple[Scores, int]] = []
    for rows, kept in pushes:
        tail.append(_numbered(newest, rows))
        newest += rows
        tail.drop(max(0, len(tail) - kept))
        given.append((tail.rows, newest))
    for scores, newest in given:
        expected = _numbered(newest - len(scores), len(scores))
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
