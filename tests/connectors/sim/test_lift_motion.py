import numpy as np
import pytest

from connectors.sim.lift_motion import Lift
from operators.errors import ParameterError

T = np.linspace(0.0, 5.0, 5001)


@pytest.mark.parametrize("lift", [Lift(1.0), Lift(1.0, 0.1, 0.2, 0.3), Lift(2.0, height=0.001, speed=0.5)])
def test_a_lift_reaches_its_height_and_keeps_its_limits(lift: Lift) -> None:
    climbed = lift.climbed(T)
    speed = np.diff(climbed) / np.diff(T)
    acceleration = np.diff(speed) / 0.001
    np.testing.assert_allclose(climbed[lift.instant >= T], 0.0, atol=1e-15)
    np.testing.assert_allclose(climbed[lift.end < T], lift.height)
    assert speed.min() >= -1e-9
    assert speed.max() <= lift.speed + 1e-9
    assert np.abs(acceleration).max() == pytest.approx(lift.acceleration, rel=1e-6)


@pytest.mark.parametrize("field", ["height", "speed", "acceleration"])
def test_a_lift_that_goes_nowhere_is_refused(field: str) -> None:
    with pytest.raises(ParameterError, match=field):
        Lift(1.0, **{field: 0.0})
