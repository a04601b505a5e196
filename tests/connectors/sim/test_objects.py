from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from connectors.sim.objects import OBJECTS, Object, named
from operators.errors import ParameterError


def test_the_six_objects_of_the_paper_go_by_the_names_that_users_type() -> None:
    assert list(OBJECTS) == [
        "box", "ball", "cardboard_can", "football_sleeve", "foam_sleeve", "metal_can",
    ]  # fmt: skip
    assert all(named(name).name == name for name in OBJECTS)


def test_an_unknown_name_says_which_are_known() -> None:
    with pytest.raises(ParameterError, match="'egg', must be one of box, ball"):
        named("egg")


@pytest.mark.parametrize("name", OBJECTS)
def test_the_inertia_is_that_of_the_filled_shape(name: str) -> None:
    thing = OBJECTS[name]
    side = (np.arange(200) + 0.5) / 200 - 0.5
    x, y, z = np.meshgrid(side * thing.width, side * thing.length, side * thing.width)
    filled = {
        "plane": np.ones(x.shape, np.bool_),
        "sphere": x**2 + y**2 + z**2 < thing.radius**2,
        "cylinder_y": x**2 + z**2 < thing.radius**2,
    }[thing.curvature]
    assert thing.inertia == pytest.approx(thing.mass * (x**2 + y**2)[filled].mean(), rel=1e-3)


@pytest.mark.parametrize(
    ("field", "build"),
    [
        ("radius", lambda: replace(OBJECTS["box"], radius=0.0)),
        ("width", lambda: replace(OBJECTS["box"], width=0.0)),
        ("length", lambda: replace(OBJECTS["box"], length=-0.1)),
        ("mass", lambda: replace(OBJECTS["box"], mass=0.0)),
        ("friction", lambda: replace(OBJECTS["box"], friction=0.0)),
        ("stiffness", lambda: replace(OBJECTS["box"], stiffness=0.0)),
        ("texture", lambda: replace(OBJECTS["box"], texture=-0.1)),
    ],
)
def test_a_value_that_no_body_has_is_refused(field: str, build: Callable[[], Object]) -> None:
    with pytest.raises(ParameterError, match=field):
        build()
