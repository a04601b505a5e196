import numpy as np
import pytest

from connectors.sim.mallet import Tap
from operators.errors import ParameterError


def test_a_tap_is_half_a_sine_of_its_momentum() -> None:
    t = np.linspace(0.9, 1.1, 20_001)
    given = Tap(1.0, 0.05, seconds=0.02).given(t)
    force = np.diff(given) / np.diff(t)
    assert given[0] == 0.0
    assert given[-1] == pytest.approx(0.05)
    assert force.max() == pytest.approx(np.pi * 0.05 / 0.04, rel=1e-4)
    assert t[:-1][force > 1e-9].min() == pytest.approx(1.0, abs=1e-4)
    assert t[:-1][force > 1e-9].max() == pytest.approx(1.02, abs=1e-4)


def test_a_tap_that_takes_no_time_is_refused() -> None:
    with pytest.raises(ParameterError, match="seconds"):
        Tap(1.0, 0.05, seconds=0.0)
