"""An object that is held: by simulated fingertips, and against closed formulas."""

from dataclasses import replace

import numpy as np
import pytest

from connectors.sim.body import GRAVITY
from connectors.sim.grasp import Grasp, Tap, least_force
from connectors.sim.objects import OBJECTS
from connectors.sim.scene import Parameters, Travel, Vibration
from tests.pages import ROOT, table

SMOOTH = Parameters(texture=0.0)
EVEN = Parameters(texture=0.0, static_friction=1.0, kinetic_friction=1.0, stribeck_speed=1.0)  # Coulomb
STIFF = replace(EVEN, stiffness=4e5, shear_stiffness=7.6e8, step=1e-4)  # nothing gives
BOX, CAN = OBJECTS["box"], OBJECTS["metal_can"]
LIFT = Travel(0.3, 0.02)
DISTANCE = 0.004  # m


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


def gripped(grasp: Grasp, force: float, closing: float = 1.0) -> Grasp:
    """The grasp, with a hand that closes with a force (N)."""
    grasp.press(force, closing)
    return grasp


def test_the_page_states_the_least_force_of_each_object() -> None:
    rows = table(ROOT / "docs/explanations/grasp.md", "## The objects")
    stated = {row["object"]: row["least force N"] for row in rows}
    assert stated == {name: f"{least_force(thing):.2f}" for name, thing in OBJECTS.items()}


@pytest.mark.parametrize("name", OBJECTS)
def test_the_least_force_is_where_a_loosening_grip_begins_to_slip(name: str) -> None:
    """With Stribeck friction, lever and tilt, but the same friction everywhere."""
    thing = OBJECTS[name]
    least = least_force(thing, SMOOTH)
    grasp = Grasp(thing, SMOOTH, lift=LIFT)
    grasp.press(1.5 * least, 0.0, rate=100.0)
    _, before = grasp.sense(2.0)
    assert not before.on_table
    grasp.press(0.5 * least, 2.0, rate=0.1 * least)
    loosening = (grasp.sense(2.01 + k * 0.01)[1] for k in range(1000))
    slipping = next(held for held in loosening if before.slide_y - held.slide_y > 0.002)
    assert slipping.force == pytest.approx(least, rel=0.05)


@pytest.mark.parametrize("name", OBJECTS)
def test_what_is_held_creeps_by_no_more_than_a_bounded_bit(name: str) -> None:
    """Ten seconds on a hand that shakes."""
    thing = OBJECTS[name]
    shaking = Vibration(5e-5, 12.0, 70.0)
    grasp = gripped(Grasp(thing, lift=Travel(1.5), vibration=shaking), 1.5 * least_force(thing))
    slides = [grasp.sense(t)[1].slide_y for t in (3.0, 8.0, 13.0)]
    assert abs(slides[2] - slides[0]) < 1e-6
    assert abs(slides[2] - slides[1]) < abs(slides[1] - slides[0]) + 2e-5


def test_a_tap_on_the_side_turns_it_and_its_mirror_image_turns_it_back() -> None:
    ends = [
        gripped(Grasp(CAN, lift=Travel(1.5), taps=[Tap(4.0, momentum, "side")]), 4.0).sense(6.0)[1]
        for momentum in (0.1, -0.1)
    ]
    assert ends[0].turned < -0.05  # pushed to the right above its middle: clockwise
    assert ends[1].turned == pytest.approx(-ends[0].turned, rel=0.05)
    assert ends[1].slide_x == pytest.approx(-ends[0].slide_x, abs=2e-4)


def test_the_force_follows_commands_at_their_rate() -> None:
    grasp = gripped(Grasp(BOX), 2.0)
    grasp.press(4.0, 2.0, rate=2.0)
    grasp.press(1.0, 2.5, rate=50.0)  # from the 3 N that are reached by then
    grasp.press(6.0, 3.0)
    force = {t: grasp.sense(t)[1].force for t in (0.9, 1.1, 1.3, 2.25, 2.5, 2.52, 2.6, 3.2)}
    expected = {0.9: 0.0, 1.1: 1.0, 1.3: 2.0, 2.25: 2.5, 2.5: 3.0, 2.52: 2.0, 2.6: 1.0, 3.2: 3.0}
    assert force == pytest.approx(expected, abs=0.06)


def test_what_is_held_too_weakly_falls_with_what_friction_leaves_of_its_weight() -> None:
    held, least = Grasp(BOX, EVEN, lift=LIFT), least_force(BOX, EVEN)
    held.press(2 * least, 0.0, rate=1e3)
    held.press(0.6 * least, 2.0, rate=1e6)
    heights = [held.sense(t)[1].height for t in (2.03, 2.04, 2.05)]
    assert np.diff(heights, 2) / 0.01**2 == pytest.approx(-0.4 * GRAVITY, rel=0.01)


@pytest.mark.parametrize("name", ["box", "ball", "foam_sleeve"])
@pytest.mark.parametrize("factor", [2.0, 4.0])
def test_a_tap_moves_it_as_far_as_friction_takes_to_use_its_energy_up(name: str, factor: float) -> None:
    thing = OBJECTS[name]
    speed = np.sqrt(2 * DISTANCE * (factor - 1) * GRAVITY)
    held = Grasp(thing, STIFF, lift=LIFT, taps=[Tap(2.0, thing.mass * speed, seconds=0.001)])
    held.press(factor * least_force(thing, STIFF), 0.0, rate=1e3)
    before, after = (held.sense(t)[1] for t in (2.0, 2.5))
    assert before.height - after.height == pytest.approx(DISTANCE, rel=0.05)
    assert before.slide_y - after.slide_y == pytest.approx(DISTANCE, rel=0.05)
