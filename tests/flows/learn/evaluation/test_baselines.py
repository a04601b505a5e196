import numpy as np

from flows.learn.evaluation.baselines import Logistic, features, window_length
from flows.learn.labelled_recordings import Sampling
from operators.batch import Counts, Flags


def shaking(seed: int) -> tuple[Counts, Flags]:
    """Return windows of which every second one has a cell that shakes for the newest 100 ms."""
    random = np.random.default_rng(seed)
    windows = random.normal(0, 3, (400, 51, 6)).round()
    slip = np.arange(400) % 2 == 1
    windows[slip, -10:, 4] += random.normal(0, 40, (200, 10)).round()
    return windows.astype(np.int16), slip


def test_the_baseline_detects_shaking_of_any_cell() -> None:
    fitted = Logistic.fitted(*shaking(0), Sampling())
    other, truth = shaking(1)
    assert ((fitted.score(other[:, :, ::-1]) > 0.5) == truth).mean() > 0.95


def test_features_cover_the_same_times_at_another_rate() -> None:
    windows = np.random.default_rng(0).normal(0, 9, (50, 51, 6))
    slow, fast = (
        features(values[:, -window_length(sampling) :], sampling).reshape(50, 4, 5)
        for sampling, values in ((Sampling(), windows), (Sampling(300.0), windows.repeat(3, axis=1)))
    )
    np.testing.assert_allclose(fast[:, :, [1, 2, 4]], slow[:, :, [1, 2, 4]])  # changes and deviations
    np.testing.assert_allclose(
        3 * np.expm1(fast[0, :, 3]) ** 2, np.expm1(slow[0, :, 3]) ** 2
    )  # steps are as many
