import numpy as np
import pytest

from connectors.sim.scene import Travel, surface_drop

K = 1 / 0.06  # 1/m


def test_beyond_the_edge_it_falls_on() -> None:
    edge = surface_drop((K, K), 0.06, 0.0)
    assert edge == pytest.approx(0.06)
    assert edge < surface_drop((K, K), 0.07, 0.0) < surface_drop((K, K), 0.3, 0.0)


@pytest.mark.parametrize(
    "travel", [Travel(1.0), Travel(1.0, 0.1, 0.2, 0.3), Travel(2.0, distance=0.001, speed=0.5)]
)
def test_a_travel_covers_its_distance_and_keeps_its_limits(travel: Travel) -> None:
    t = np.linspace(0.0, 5.0, 5001)
    distance, speed = travel.at(t)
    np.testing.assert_allclose(distance[travel.start >= t], 0.0, atol=1e-15)
    np.testing.assert_allclose(distance[travel.end < t], travel.distance)
    most = travel.acceleration * 0.001 / 4  # m/s, where the ramps meet between two instants
    np.testing.assert_allclose(np.diff(distance) / 0.001, (speed[1:] + speed[:-1]) / 2, rtol=0, atol=most)
    assert speed.min() >= -1e-9
    assert speed.max() <= travel.speed + 1e-9
    assert np.abs(np.diff(speed)).max() / 0.001 == pytest.approx(travel.acceleration, rel=1e-6)
