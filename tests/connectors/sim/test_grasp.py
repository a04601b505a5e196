import pytest

from connectors.sim.grasp import Grasp, Tap, least_force
from connectors.sim.objects import OBJECTS
from connectors.sim.scene import Parameters, Travel, Vibration

SMOOTH = Parameters(texture=0.0)


def gripped(grasp: Grasp, force: float, closing: float = 1.0) -> Grasp:
    """The grasp, with a hand that closes with a force (N)."""
    grasp.press(force, closing)
    return grasp


@pytest.mark.parametrize("name", OBJECTS)
def test_the_least_force_is_where_a_loosening_grip_begins_to_slip(name: str) -> None:
    """With Stribeck friction, lever and tilt, but the same friction everywhere."""
    thing = OBJECTS[name]
    least = least_force(thing, SMOOTH)
    grasp = Grasp(thing, SMOOTH, lift=Travel(0.3, 0.02))
    grasp.press(1.5 * least, 0.0, rate=100.0)
    _, before = grasp.sense(2.0)
    assert not before.on_table
    grasp.press(0.5 * least, 2.0, rate=0.1 * least)
    loosening = (grasp.sense(2.01 + k * 0.01)[1] for k in range(1000))
    slipping = next(held for held in loosening if before.slide_y - held.slide_y > 0.002)
    assert slipping.force == pytest.approx(least, rel=0.05)


BOX, CAN = OBJECTS["box"], OBJECTS["metal_can"]


@pytest.mark.parametrize("name", OBJECTS)
def test_what_is_held_creeps_by_no_more_than_a_bounded_bit(name: str) -> None:
    """Ten seconds on a hand that shakes."""
    thing = OBJECTS[name]
    shaking = Vibration(5e-5, 12.0, 70.0)
    grasp = gripped(Grasp(thing, lift=Travel(1.5), vibration=shaking), 1.5 * least_force(thing))
    slides = [grasp.sense(t)[1].slide_y for t in (3.0, 8.0, 13.0)]
    assert abs(slides[2] - slides[0]) < 2e-4
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
