import numpy as np
import pytest

from connectors.sim.grasp_actions import Lift, Tap

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


def test_a_tap_is_half_a_sine_of_its_momentum() -> None:
    t = np.linspace(0.9, 1.1, 20_001)
    given = Tap(1.0, 0.05, seconds=0.02).momentum_until(t)
    force = np.diff(given) / np.diff(t)
    assert given[0] == 0.0
    assert given[-1] == pytest.approx(0.05)
    assert force.max() == pytest.approx(np.pi * 0.05 / 0.04, rel=1e-4)
    assert t[:-1][force > 1e-9].min() == pytest.approx(1.0, abs=1e-4)
    assert t[:-1][force > 1e-9].max() == pytest.approx(1.02, abs=1e-4)
