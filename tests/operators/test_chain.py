import pickle

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators import Scores
from operators.chain import Chain

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


def test_a_batch_that_is_taken_whole_is_not_copied() -> None:
    chain, batch = Chain(Scores), _scores([1, 2, 3])
    chain.append(batch)
    chain.append(_scores([4]))
    assert chain.take(4) is batch


@given(time=stamps, sizes=sizes, before=instants)
def test_a_pickle_holds_only_the_rows_in_use_and_resumes(
    time: list[int], sizes: list[int], before: int
) -> None:
    scores = _scores(time)
    chain = _chain(scores, sizes)
    chain.take(before)
    again = pickle.loads(pickle.dumps(chain))  # noqa: S301 our own bytes
    later = Scores(np.array([40]), np.array([99.0]), finger=3)
    again.append(later)
    assert _values(again.take()) == _values(scores[scores.time >= before], later)


def test_a_pickle_is_small_whatever_the_batches_were_cut_from() -> None:
    whole, chain = _scores(list(range(100_000))), Chain(Scores)
    for row in range(10):
        chain.append(whole[row : row + 1])
    assert len(pickle.dumps(chain)) < 1000
