import re

import numpy as np
import pytest

from flows.learn.evaluation import boosting
from flows.learn.evaluation.boosting import GradientBoosting, features
from operators.batch import Counts, Flags
from operators.errors import InputError


def shaking(seed: int) -> tuple[Counts, Flags]:
    """Windows that rest, and windows in which one barometer shakes for the newest 100 ms."""
    random = np.random.default_rng(seed)
    seen = random.normal(0, 3, (400, 41, 6)).round()
    slip = np.arange(400) % 2 == 1
    seen[slip, -10:, 4] += random.normal(0, 40, (200, 10)).round()
    return seen.astype(np.int16), slip


def test_it_learns_what_shakes() -> None:
    pytest.importorskip("sklearn")
    seen, slip = shaking(0)
    fitted = GradientBoosting.fitted(seen, slip)
    other, truth = shaking(1)
    assert ((fitted.score(other) > 0.5) == truth).mean() > 0.95


def test_it_sees_88_features_whatever_the_order_of_the_barometers() -> None:
    seen, _ = shaking(0)
    assert features(seen).shape == (400, 88)
    np.testing.assert_allclose(features(seen), features(seen[:, :, ::-1]))


def test_without_scikit_learn_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        del name

    monkeypatch.setattr(boosting, "find_spec", missing)
    with pytest.raises(InputError, match=re.escape("pip install -e '.[train]'")):
        GradientBoosting.fitted(*shaking(0))
