import numpy as np
import pytest

from flows.learn.spans import runs


@pytest.mark.parametrize("count", [0, 1, 7])
def test_all_true_is_one_run_and_all_false_is_none(count: int) -> None:
    assert runs(np.ones(count, np.bool_)).tolist() == ([[0, count]] if count else [])
    assert runs(np.zeros(count, np.bool_)).shape == (0, 2)


def test_runs_cover_what_is_true_and_nothing_else() -> None:
    flags = np.random.default_rng(0).random(500) < 0.5
    covered = np.zeros(500, np.bool_)
    for first, end in runs(flags).tolist():
        assert not covered[max(first - 1, 0)], "runs do not touch"
        covered[first:end] = True
    assert np.array_equal(covered, flags)
