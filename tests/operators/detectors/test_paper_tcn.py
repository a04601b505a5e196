from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from operators import SLIP
from operators.detectors import PaperTcn
from tests.operators.detectors.test_psd import TRACE, real_windows

Arrays = dict[str, NDArray[Any]]


def _real(name: str) -> Arrays:
    path = TRACE.with_name(name)
    if not path.exists():
        pytest.skip(f"no real weights at {path}")
    with np.load(path) as arrays:
        return dict(arrays)


def test_the_probabilities_equal_those_of_the_original_network() -> None:
    vectors = _real("paper_tcn_vectors.npz")
    probability = PaperTcn(_real("paper_tcn.npz")).probability(vectors["inputs"])
    np.testing.assert_allclose(probability, vectors["slip_probability"], atol=1e-5)


def test_it_has_the_originals_accuracy_on_the_real_trace() -> None:
    detector = PaperTcn(_real("paper_tcn.npz"))
    windows, labels = real_windows(100)
    right = (detector.score(windows) >= 0.5) == (labels == SLIP)
    assert len(right) == 278
    assert right.mean() == pytest.approx(0.687, abs=5e-4)
