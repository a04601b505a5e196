import pytest

from connectors.sim.body import GRAVITY
from connectors.sim.grasp import Grasp
from connectors.sim.holding import PASSIVE_FRICTION, grip, least_force, material, surface
from connectors.sim.lift_motion import Lift
from connectors.sim.objects import OBJECTS
from connectors.sim.physics_parameters import Parameters

SMOOTH = Parameters(texture=0.0)


@pytest.mark.parametrize("name", OBJECTS)
def test_the_least_force_is_where_a_loosening_grip_begins_to_slip(name: str) -> None:
    """Of the scene's own material, with Stribeck friction, lever and tilt, but one friction everywhere."""
    thing = OBJECTS[name]
    least = least_force(thing, SMOOTH)
    grasp = Grasp(thing, SMOOTH, force=1.5 * least, closing=0.0, rate=100.0, lift=Lift(0.3, 0.02))
    _, before = grasp.sense(2.0)
    assert not before.on_table
    grasp.press(0.5 * least, 2.0, rate=0.1 * least)
    loosening = (grasp.sense(2.01 + k * 0.01)[1] for k in range(1000))
    slipping = next(held for held in loosening if before.slide_y - held.slide_y > 0.002)
    assert slipping.force == pytest.approx(least, rel=0.05)


def test_the_least_force_scales_as_weight_over_friction() -> None:
    can = OBJECTS["metal_can"]
    least = least_force(can)
    assert least_force(can, mass=2.0) == pytest.approx(2 * least)
    assert least_force(can, friction=0.5) == pytest.approx(2 * least)
    assert least_force(can, acceleration=GRAVITY) == pytest.approx(2 * least)
    only_passive = can.mass * GRAVITY / (can.friction * PASSIVE_FRICTION)
    assert least_force(can, texture=0.0) == pytest.approx(only_passive)


def test_rough_and_soft_objects_are_another_material() -> None:
    nominal = Parameters()
    rough = material(OBJECTS["metal_can"], nominal)
    soft = material(OBJECTS["foam_sleeve"], nominal)
    assert nominal.texture < rough.texture < 1
    assert soft.normal_stiffness < nominal.normal_stiffness == rough.normal_stiffness
    assert soft.static_friction / soft.kinetic_friction == pytest.approx(2.1 / 0.97)


def test_the_foot_stands_on_the_table_wherever_it_is_gripped() -> None:
    box = OBJECTS["box"]
    held = grip(box, surface(box, Parameters()), (0.0, 0.03), 0.6)
    assert held.table == pytest.approx(-0.03 - box.length / 2)
    assert held.foot == pytest.approx(box.width / 2)
    assert held.contact.k_x == held.contact.k_y == 0.0
