from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.detectors.tcn import Tcn

torch = pytest.importorskip("torch")


@pytest.mark.parametrize("filters", [5, 12])
def test_torch_says_what_the_detector_says(
    filters: int, unlearned: Callable[[int], dict[str, NDArray[Any]]]
) -> None:
    from flows.learn.chart.torch_eager import TorchEager  # noqa: PLC0415 - needs torch

    tcn, random = Tcn(unlearned(filters)), np.random.default_rng(filters)
    windows = random.integers(-400, 100, (50, tcn.length, 6)).astype(np.int16)
    eager = TorchEager(tcn)
    assert eager.length == tcn.length == 100
    found = eager.score(windows)
    assert np.ptp(found) > 0.1
    np.testing.assert_allclose(found, tcn.score(windows), atol=1e-5)
