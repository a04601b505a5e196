"""A simulated arm with delay and limited acceleration follows a line."""

import math
from collections import deque

import numpy as np
import pytest

from connectors.ur.path_follower import PathFollower
from connectors.ur.ur_state import Point
from operators.batch import Reals

STEP = 0.004  # s
RADIUS = 0.06  # m


def arc(half: float, bends: int = 30) -> list[Point]:
    """Return points over a sphere, from one side to the other."""
    across = np.linspace(-half, half, bends + 1)
    return [(float(x), 0.0, math.sqrt(RADIUS**2 - x * x)) for x in across]


def steered(points: list[Point], speed: float, *, late: float = 0.04, every: int = 5) -> tuple[Reals, Reals]:
    """Return positions (n, 3) and speeds (n,) of an arm that obeys `late` (s), at 0.5 m/s2."""
    follower, delayed = PathFollower(points, speed, 0.5), deque([np.zeros(3)] * round(late / STEP))
    here, velocity, aim = np.array(points[0]), np.zeros(3), np.zeros(3)
    way, speeds, found = [here.copy()], [0.0], follower.velocity(points[0])
    for tick in range(5000):
        if tick % every == 0:
            found = follower.velocity((here.item(0), here.item(1), here.item(2)))
            aim = np.zeros(3) if found is None else np.array(found)
        delayed.append(aim)
        change = delayed.popleft() - velocity
        velocity = velocity + change * min(1.0, 0.5 * STEP / max(1e-12, float(np.linalg.norm(change))))
        here = here + velocity * STEP
        way.append(here.copy())
        speeds.append(float(np.linalg.norm(velocity)))
        if found is None and speeds[-1] < 1e-9:
            return np.array(way), np.array(speeds)
    raise AssertionError("never arrived")


@pytest.mark.parametrize("speed", [0.005, 0.05, 0.1])
@pytest.mark.parametrize(("late", "off"), [(0.01, 0.001), (0.03, 0.0004), (0.06, 0.001)])  # s, m
def test_an_arc_is_followed_at_its_speed_and_height_to_its_end(speed: float, late: float, off: float) -> None:
    points = arc(0.03)
    way, speeds = steered(points, speed, late=late)
    height = np.hypot(way[:, 0], way[:, 2]) - RADIUS  # (n,) m
    assert np.abs(height).max() < off
    cruise = speeds[len(speeds) // 3 : -len(speeds) // 3]
    np.testing.assert_allclose(cruise, speed, rtol=0.03)
    assert math.dist(way[-1], points[-1]) < 1.5e-3 + late * speed
