import numpy as np

from flows.learn.evaluation.baselines import GradientBoosting, Logistic, activity, activity_and_steps
from flows.run.processes import one_thread
from operators.batch import Counts, Flags


def shaking(seed: int) -> tuple[Counts, Flags]:
    """Return windows of which every second one has a cell that shakes for the newest 100 ms."""
    random = np.random.default_rng(seed)
    windows = random.normal(0, 3, (400, 41, 6)).round()
    slip = np.arange(400) % 2 == 1
    windows[slip, -10:, 4] += random.normal(0, 40, (200, 10)).round()
    return windows.astype(np.int16), slip


def test_gradient_boosting_detects_shaking() -> None:
    with one_thread():  # as in evaluations; busy cores slow several threads down
        fitted = GradientBoosting.fitted(*shaking(0))
    other, truth = shaking(1)
    assert ((fitted.score(other) > 0.5) == truth).mean() > 0.95


def test_logistic_regression_detects_shaking_of_any_cell() -> None:
    fitted = Logistic.fitted(*shaking(0))
    other, truth = shaking(1)
    assert ((fitted.score(other[:, :, ::-1]) > 0.5) == truth).mean() > 0.95


def test_features_do_not_depend_on_the_order_of_the_cells() -> None:
    windows, _ = shaking(0)
    for features, number in ((activity, 48), (activity_and_steps, 88)):
        assert features(windows).shape == (400, number)
        np.testing.assert_allclose(features(windows), features(windows[:, :, ::-1]))
