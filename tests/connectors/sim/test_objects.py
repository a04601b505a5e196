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


def test_they_differ_as_the_paper_says() -> None:
    curved = {name: thing.curvature for name, thing in OBJECTS.items()}
    assert curved["box"] == "plane"
    assert curved["ball"] == curved["football_sleeve"] == "sphere"
    assert {curved[name] for name in ("cardboard_can", "foam_sleeve", "metal_can")} == {"cylinder_y"}
    rough = {name for name, thing in OBJECTS.items() if thing.texture > 1}
    soft = {name for name, thing in OBJECTS.items() if thing.stiffness < 1}
    assert rough == {"football_sleeve", "metal_can"}
    assert soft == {"football_sleeve", "foam_sleeve"}


def test_what_stands_in_a_hand_can_be_carried_by_it() -> None:
    assert all(0.05 <= thing.mass <= 0.6 for thing in OBJECTS.values())
    assert all(thing.reach <= thing.length / 2 for thing in OBJECTS.values())


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


def test_a_can_that_lies_has_the_inertia_of_one_that_stands() -> None:
    can = OBJECTS["metal_can"]
    lying = replace(can, curvature="cylinder_x", width=can.length, length=can.width)
    assert lying.inertia == pytest.approx(can.inertia)
    assert lying.foot == 0.0


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
