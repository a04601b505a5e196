import numpy as np
import pytest

from connectors.sim.grasp import Grasp, GraspState, Tap, least_force
from connectors.sim.objects import OBJECTS
from connectors.sim.scene import Parameters, Travel, Vibration
from operators.batch import Touch, concat

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


BOX, BALL, CAN = OBJECTS["box"], OBJECTS["ball"], OBJECTS["metal_can"]


def watch(grasp: Grasp, until: float, start: float = 0.0) -> tuple[Touch, list[GraspState]]:
    """100 samples a second."""
    sensed = [grasp.sense(k / 100) for k in range(round(start * 100), round(until * 100))]
    return concat(Touch, [touch for touch, _ in sensed]), [held for _, held in sensed]


@pytest.mark.parametrize("name", OBJECTS)
def test_a_firm_grip_lifts_and_the_object_follows_the_hand(name: str) -> None:
    thing = OBJECTS[name]
    touch, held = watch(gripped(Grasp(thing, lift=Travel(2.0)), 2.6 * least_force(thing)), 4.0)
    touch.check()
    assert not any(h.force or h.height > 1e-5 for h in held[:100])
    assert all(h.on_table for h in held[:200])
    aloft = held[210:]
    assert not any(h.on_table or h.dropped for h in aloft)
    assert max(abs(h.height - h.hand) for h in aloft) < 3e-3
    assert max(abs(h.slide_y) for h in aloft) < 1e-4
    assert aloft[-1].hand == pytest.approx(0.05)


@pytest.mark.parametrize("name", OBJECTS)
def test_what_is_held_creeps_by_no_more_than_a_bounded_bit(name: str) -> None:
    """Ten seconds on a hand that shakes."""
    thing = OBJECTS[name]
    shaking = Vibration(5e-5, 12.0, 70.0)
    grasp = gripped(Grasp(thing, lift=Travel(1.5), vibration=shaking), 1.5 * least_force(thing))
    slides = [grasp.sense(t)[1].slide_y for t in (3.0, 8.0, 13.0)]
    assert abs(slides[2] - slides[0]) < 2e-4
    assert abs(slides[2] - slides[1]) < abs(slides[1] - slides[0]) + 2e-5


@pytest.mark.parametrize("name", OBJECTS)
def test_a_grip_that_is_far_too_weak_leaves_it_on_the_table(name: str) -> None:
    thing = OBJECTS[name]
    climb = Travel(2.0, distance=thing.length, speed=0.1)
    touch, held = watch(gripped(Grasp(thing, lift=climb), 0.3 * least_force(thing)), climb.end + 1.0)
    assert held[-1].dropped
    assert held[-1].on_table
    assert held[-1].force == 0.0
    assert abs(held[-1].height) < 1e-3
    assert held[-1].hand == pytest.approx(thing.length)
    sliding = [h for h in held if h.speed > 0.003 and h.instant < climb.end]
    assert sliding[0].instant == pytest.approx(2.0, abs=0.1)
    gone = next(h for h in held if h.dropped)
    assert gone.hand == pytest.approx(thing.reach, abs=4e-3)
    assert (np.ptp(touch.counts[:100], axis=0) <= 8).all()


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


def test_the_same_seed_gives_the_same_and_another_differs_in_its_cells_alone() -> None:
    def run(seed: int) -> tuple[Touch, list[GraspState]]:
        return watch(gripped(Grasp(CAN, seed=seed, lift=Travel(1.5), taps=[Tap(2.0, 0.1)]), 2.0), 3.0)

    (one, held), (again, also), (other, truth) = run(3), run(3), run(4)
    np.testing.assert_array_equal(one.counts, again.counts)
    assert held == also == truth
    assert (one.counts != other.counts).any()


def test_a_tap_is_half_a_sine_of_its_momentum() -> None:
    t = np.linspace(0.9, 1.1, 20_001)
    given = Tap(1.0, 0.05, seconds=0.02).momentum_until(t)
    force = np.diff(given) / np.diff(t)
    assert given[0] == 0.0
    assert given[-1] == pytest.approx(0.05)
    assert force.max() == pytest.approx(np.pi * 0.05 / 0.04, rel=1e-4)
    assert t[:-1][force > 1e-9].min() == pytest.approx(1.0, abs=1e-4)
    assert t[:-1][force > 1e-9].max() == pytest.approx(1.02, abs=1e-4)
