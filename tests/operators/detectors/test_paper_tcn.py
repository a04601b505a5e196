from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.detectors import PaperTcn

REAL = Path(__file__).parents[3].parent / "shared" / "real"
Arrays = dict[str, NDArray[Any]]


def _real(name: str) -> Arrays:
    if not (REAL / name).exists():
        pytest.skip(f"no real weights at {REAL / name}")
    with np.load(REAL / name) as arrays:
        return dict(arrays)


def test_the_probabilities_equal_those_of_the_original_network() -> None:
    vectors = _real("paper_tcn_vectors.npz")
    probability = PaperTcn(_real("paper_tcn.npz")).probability(vectors["inputs"])
    np.testing.assert_allclose(probability, vectors["slip_probability"], atol=1e-5)


def test_it_has_the_originals_accuracy_on_the_real_trace() -> None:
    detector = PaperTcn(_real("paper_tcn.npz"))
    table = np.genfromtxt(REAL / "mat_trace.csv", delimiter=",", names=True)
    counts = np.stack([table[f"s{cell}"] for cell in range(1, 7)], axis=1).astype(np.int16)
    windows = np.lib.stride_tricks.sliding_window_view(counts, 100, axis=0).swapaxes(1, 2)
    right = (detector.score(windows) >= 0.5) == (table["label"][99:] == 1)
    assert len(right) == 278
    assert right.mean() == pytest.approx(0.687, abs=5e-4)
