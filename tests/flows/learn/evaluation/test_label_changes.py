import numpy as np

from flows.learn.evaluation.label_changes import EDGES, LabelChanges, distance


def test_the_nearest_change_counts_whether_before_or_after() -> None:
    label = np.array([0] * 10 + [1] * 6 + [0] * 4, np.int8)
    expected = [90, 80, 70, 60, 50, 40, 30, 20, 10, 0, 0, 10, 20, 20, 10, 0, 0, 10, 20, 30]
    assert distance(label).tolist() == expected


def test_a_label_that_never_changes_is_infinitely_far() -> None:
    assert np.isinf(distance(np.ones(4, np.int8))).all()


def test_errors_are_counted_where_they_are() -> None:
    label = np.array([0] * 100 + [1] * 100, np.int8)
    at = np.arange(50, 200)
    wrong = np.zeros(150, np.bool_)
    wrong[[49, 50, 149]] = True  # two at the change, one a second from it
    found = LabelChanges.of([label], [at], [wrong])
    assert found.samples.sum() == 150
    assert found.errors.tolist() == [2, *[0] * (len(EDGES) - 2), 1]
    assert found.accuracy[0] == 50
    assert found.near(20) == 100 * 2 / 3
    assert found.far(400) == 100 * 69 / 70
