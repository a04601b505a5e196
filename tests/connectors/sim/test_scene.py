import math

import pytest

from connectors.sim.scene import surface_drop

K = 1 / 0.06  # 1/m


def test_a_sphere_falls_away_as_its_arc_all_around() -> None:
    for angle in (0.1, 0.5, 0.7):
        for heading in (0.0, 0.8, 4.0):
            x, y = 0.06 * math.sin(angle) * math.cos(heading), 0.06 * math.sin(angle) * math.sin(heading)
            assert surface_drop((K, K), x, y) == pytest.approx(0.06 * (1 - math.cos(angle)))


def test_a_cylinder_falls_away_across_its_axis_only() -> None:
    assert surface_drop((0.0, K), 0.05, 0.0) == 0.0
    assert surface_drop((0.0, K), 0.05, 0.03) == pytest.approx(0.06 - math.sqrt(0.06**2 - 0.03**2))
    assert surface_drop((K, 0.0), 0.03, 0.05) == surface_drop((0.0, K), 0.05, 0.03)


def test_a_plane_does_not_fall() -> None:
    assert surface_drop((0.0, 0.0), 1.0, -2.0) == 0.0


def test_beyond_the_edge_it_falls_on() -> None:
    edge = surface_drop((K, K), 0.06, 0.0)
    assert edge == pytest.approx(0.06)
    assert edge < surface_drop((K, K), 0.07, 0.0) < surface_drop((K, K), 0.3, 0.0)
