from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from connectors.sim import body, grasp
from connectors.sim.body import GRAVITY, BodyState, GripModel
from connectors.sim.contact import FingerState, Pad
from connectors.sim.finger import pad
from connectors.sim.objects import OBJECTS, Object
from connectors.sim.scene import Parameters
from operators.batch import Reals

BOX = OBJECTS["box"]
EVEN = Parameters(texture=0.0, static_friction=1.0, kinetic_friction=1.0, stribeck_speed=1.0)  # Coulomb
STIFF = replace(EVEN, stiffness=4e5, shear_stiffness=7.6e8, step=1e-4)  # nothing gives


class Held:
    """An object that stands on the table between open fingers, and what moves it."""

    def __init__(
        self,
        thing: Object,
        parameters: Parameters | None = None,
        place: tuple[float, float] = (0.0, 0.0),
        passive: float | None = None,
    ) -> None:
        scene = grasp.surface(thing, parameters or Parameters())
        self.thing, self.step = thing, scene.parameters.step
        self.grip: GripModel = grasp.grip_model(thing, scene, place, passive)
        self.pad: Pad = pad(scene)
        self.tip = FingerState.rest(len(self.pad.x))
        sunk = thing.mass * GRAVITY / (2 * grasp.TABLE_STIFFNESS)
        self.body = BodyState.standing(-place[0], -place[1] - sunk)

    def drive(self, seconds: float, force: float = 0.0, *, climb: float = 0.0) -> Reals:
        drive = np.zeros((round(seconds / self.step), 9))
        drive[:, 1], drive[:, 3] = climb, force
        return drive

    def go(self, drive: Reals, by: ModuleType = body) -> tuple[Reals, float, float]:
        tractions, slid, slid_passive = by.simulate(self.grip, self.pad, self.tip, self.body, drive)
        return tractions, slid, slid_passive

    def lifted(self, force: float) -> "Held":
        """Gripped, lifted by a centimetre, and at rest."""
        self.go(self.drive(0.2, force))
        self.go(self.drive(0.2, force, climb=0.05))
        self.go(self.drive(2.0, force))
        return self

    @property
    def friction(self) -> float:
        """Friction of both sides together."""
        return float(self.grip.contact.mu_s + self.grip.mu)


def test_what_is_held_too_weakly_falls_with_what_friction_leaves_of_its_weight() -> None:
    held = Held(BOX, EVEN)
    least = BOX.mass * GRAVITY / held.friction
    held.lifted(2 * least)
    held.go(held.drive(0.03, 0.6 * least))
    before = float(held.body.velocity[1])
    held.go(held.drive(0.02, 0.6 * least))
    assert (held.body.velocity[1] - before) / 0.02 == pytest.approx(-0.4 * GRAVITY, rel=0.01)


@pytest.mark.parametrize("name", ["box", "ball", "foam_sleeve"])
@pytest.mark.parametrize("factor", [2.0, 4.0])
def test_a_tap_moves_it_as_far_as_friction_takes_to_use_its_energy_up(name: str, factor: float) -> None:
    held = Held(OBJECTS[name], STIFF)
    m, force = held.thing.mass, factor * held.thing.mass * GRAVITY / held.friction
    held.lifted(force)
    speed = np.sqrt(2 * 0.004 * (factor - 1) * GRAVITY)  # for 4 mm
    before = held.body.pose[1]
    blow = held.drive(0.001, force)
    blow[:, 7] = -m * speed / 0.001
    held.go(blow)
    held.go(held.drive(0.5, force))
    friction = held.friction * force
    expected = (m * speed) ** 2 / (2 * m * (friction - m * GRAVITY))
    assert before - held.body.pose[1] == pytest.approx(expected, rel=0.05)
    assert -held.body.slide[1] == pytest.approx(expected, rel=0.05)
