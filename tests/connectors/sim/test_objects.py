import numpy as np
import pytest

from connectors.sim.objects import OBJECTS


@pytest.mark.parametrize("name", OBJECTS)
def test_the_inertia_is_that_of_the_filled_shape(name: str) -> None:
    thing = OBJECTS[name]
    side = (np.arange(100) + 0.5) / 100 - 0.5
    x, y, z = np.meshgrid(side * thing.width, side * thing.length, side * thing.width)
    filled = {
        "plane": np.ones(x.shape, np.bool_),
        "sphere": x**2 + y**2 + z**2 < thing.radius**2,
        "cylinder_y": x**2 + z**2 < thing.radius**2,
    }[thing.curvature]
    assert thing.inertia == pytest.approx(thing.mass * (x**2 + y**2)[filled].mean(), rel=1e-3)
