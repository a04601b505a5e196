import numpy as np

from flows.learn.evaluation.baselines import ACTIVITY_FEATURES, STROKE_FEATURES, Logistic
from flows.learn.labelled_recordings import Sampling
from operators.batch import Counts, Flags


def shaking(seed: int) -> tuple[Counts, Flags]:
    """Return windows of which every second one has a cell that shakes for the newest 100 ms."""
    random = np.random.default_rng(seed)
    windows = random.normal(0, 3, (400, 41, 6)).round()
    slip = np.arange(400) % 2 == 1
    windows[slip, -10:, 4] += random.normal(0, 40, (200, 10)).round()
    return windows.astype(np.int16), slip


def test_the_baseline_detects_shaking_of_any_cell() -> None:
    fitted = Logistic.fitted(*shaking(0), ACTIVITY_FEATURES, Sampling())
    other, truth = shaking(1)
    assert ((fitted.score(other[:, :, ::-1]) > 0.5) == truth).mean() > 0.95


def test_features_cover_the_same_times_at_another_rate() -> None:
    windows = np.random.default_rng(0).normal(0, 9, (50, 51, 6))
    fast = windows.repeat(3, axis=1)
    activities, strokes = (
        [
            one.compute(values[:, -one.length(sampling) :], sampling)
            for sampling, values in ((Sampling(), windows), (Sampling(300.0), fast))
        ]
        for one in (ACTIVITY_FEATURES, STROKE_FEATURES)
    )
    slow, found = (np.expm1(each).reshape(50, 4, 2, 6) for each in activities)
    np.testing.assert_allclose(found[:, :, 0], slow[:, :, 0])  # variances
    np.testing.assert_allclose(3 * found[:, :, 1], slow[:, :, 1])  # mean squares of steps, which are as many
    slow, found = (each.reshape(50, 4, 5)[:, :, [1, 2, 4]] for each in strokes)  # changes and deviations
    np.testing.assert_allclose(found, slow)
