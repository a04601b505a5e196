"""An object that is held, against closed formulas."""

from dataclasses import replace

import numpy as np
import pytest

from connectors.sim.body import GRAVITY
from connectors.sim.grasp import Grasp, Tap, least_force
from connectors.sim.objects import OBJECTS
from connectors.sim.scene import Parameters, Travel

BOX = OBJECTS["box"]
EVEN = Parameters(texture=0.0, static_friction=1.0, kinetic_friction=1.0, stribeck_speed=1.0)  # Coulomb
STIFF = replace(EVEN, stiffness=4e5, shear_stiffness=7.6e8, step=1e-4)  # nothing gives
LIFT = Travel(0.3, 0.02)
DISTANCE = 0.004  # m


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
