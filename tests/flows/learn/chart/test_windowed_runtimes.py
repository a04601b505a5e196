from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from flows.learn.chart.windowed_runtimes import OnnxWindowed, TorchEager
from operators.detectors.tcn import Tcn


@pytest.mark.parametrize("filters", [5, 12])
@pytest.mark.parametrize("runtime", [TorchEager, OnnxWindowed])
def test_other_libraries_agree_with_the_detector(
    runtime: type[TorchEager | OnnxWindowed],
    filters: int,
    unlearned: Callable[[int], dict[str, NDArray[Any]]],
) -> None:
    tcn, random = Tcn(unlearned(filters)), np.random.default_rng(filters)
    windows = random.integers(-400, 100, (50, tcn.length, 6)).astype(np.int16)
    other = runtime(tcn)
    assert other.length == tcn.length == 100
    found = other.score(windows)
    assert np.ptp(found) > 0.1
    np.testing.assert_allclose(found, tcn.score(windows), atol=1e-5)
