import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators import Batch, Scores
from operators.row_queues import Chain, Tail

stamps = st.lists(st.integers(0, 30), min_size=1, max_size=30).map(sorted)
sizes = st.lists(st.integers(1, 5), max_size=30)
instants = st.integers(-1, 31)


def _scores(time: list[int]) -> Scores:
    return Scores(np.array(time, np.int64), np.arange(len(time)) / 4, finger=3)


def _chain(scores: Scores, sizes: list[int]) -> Chain[Scores]:
    """The rows in batches of those sizes, and the rest in one."""
    chain, start = Chain(Scores), 0
    for size in [*sizes, len(scores)]:
        if start < len(scores):
            chain.append(scores[start : start + size])
        start += size
    return chain


def _values(*batches: Scores) -> list[float]:
    return [value for batch in batches for value in batch.probability.tolist()]


@given(time=stamps, sizes=sizes, before=instants)
def test_the_rows_older_than_an_instant_are_taken_once_and_in_order(
    time: list[int], sizes: list[int], before: int
) -> None:
    scores = _scores(time)
    chain = _chain(scores, sizes)
    assert _values(chain.take(before)) == _values(scores[scores.time < before])
    assert not len(chain.take(before))
    assert len(chain) == len(scores[scores.time >= before])
    assert _values(chain.take()) == _values(scores[scores.time >= before])


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
