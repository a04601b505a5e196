import math

import numpy as np
import pytest

from operators.detectors.tcn import Tcn, shapes

torch = pytest.importorskip("torch")


@pytest.mark.parametrize("filters", [5, 12])
def test_torch_says_what_the_detector_says(filters: int) -> None:
    from flows.evaluation.torch_eager import TorchEager  # noqa: PLC0415 - needs torch

    random = np.random.default_rng(filters)
    weights = {
        name: random.normal(0, math.prod(shape[:-1]) ** -0.5, shape).astype(np.float32)
        for name, shape in shapes(8, filters, 24, 3).items()
    }
    weights |= {
        "dilations": np.array([1, 2, 4]),
        "position_scale": np.array([8], np.float32),
        "step_scale": np.array([1.5], np.float32),
    }
    tcn = Tcn(weights)
    windows = random.integers(-400, 100, (50, tcn.length, 6)).astype(np.int16)
    eager = TorchEager(tcn)
    assert eager.length == tcn.length == 100
    found = eager.score(windows)
    assert np.ptp(found) > 0.1
    np.testing.assert_allclose(found, tcn.score(windows), atol=1e-5)
