import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flows.learn.evaluation.baselines import sklearn
from flows.learn.evaluation.sample_metrics import (
    accuracy,
    balanced,
    confusion,
    distance,
    f1,
    precision,
)
from flows.learn.sampling import Sampling
from operators.batch import Flags, Reals

PAIRS = st.lists(st.tuples(st.integers(0, 20), st.booleans()), min_size=2, max_size=60)


def split(pairs: list[tuple[int, bool]]) -> tuple[Reals, Flags]:
    probability, truth = zip(*pairs, strict=True)
    return np.array(probability) / 20, np.array(truth)


@given(PAIRS)
def test_scores_of_counts_are_those_of_the_samples(pairs: list[tuple[int, bool]]) -> None:
    probability, truth = split(pairs)
    predicted = probability >= 0.5
    found = confusion(predicted, truth)
    metrics = sklearn("metrics")
    expected = metrics.precision_recall_fscore_support(truth, predicted, average="weighted", zero_division=0)
    assert (precision(found), accuracy(found), f1(found)) == pytest.approx(100 * np.array(expected[:3]))
    assert accuracy(found) == pytest.approx(100 * metrics.accuracy_score(truth, predicted))
    if truth.any() and not truth.all():
        assert balanced(found) == pytest.approx(100 * metrics.balanced_accuracy_score(truth, predicted))


def test_the_nearest_change_counts_whether_before_or_after() -> None:
    label = np.array([0] * 10 + [1] * 6 + [0] * 4, np.int8)
    expected = [90, 80, 70, 60, 50, 40, 30, 20, 10, 0, 0, 10, 20, 20, 10, 0, 0, 10, 20, 30]
    assert distance(label, Sampling()).tolist() == expected


def test_a_label_that_never_changes_is_infinitely_far() -> None:
    assert np.isinf(distance(np.ones(4, np.int8), Sampling())).all()
