import numpy as np

from flows.learn.evaluation.logistic import Logistic


def test_the_logistic_regression_tells_shaking_from_rest_on_any_barometer() -> None:
    random = np.random.default_rng(0)
    rest = random.normal(0, 1, (200, 41, 6)).round().astype(np.int16)
    shaking = rest.copy()
    shaking[:, :, 2] += random.normal(0, 40, (200, 41)).round().astype(np.int16)
    slip = np.arange(400) >= 200
    logistic = Logistic.fitted(np.concatenate([rest, shaking]), slip)
    assert ((logistic.score(shaking[:, :, ::-1]) > 0.5).mean(), (logistic.score(rest) < 0.5).mean()) == (1, 1)
