from itertools import permutations

import numpy as np
import pytest

from connectors.sim import contact
from connectors.sim.finger import contact_model, pad
from connectors.sim.scene import Parameters, Scene
from operators.batch import Curvature, Reals

CURVATURES: tuple[Curvature, ...] = ("plane", "sphere", "cylinder_x", "cylinder_y")


def drag(steps: int, speed: float = 0.05, force: float = 2.0) -> Reals:
    """Half of the time pressing ever harder, then dragging."""
    drive = np.zeros((steps, 6))
    drive[:, 3] = force * np.minimum(1.0, np.arange(steps) / (steps / 4))
    drive[steps // 2 :, :3] = speed * np.cos(0.4), speed * np.sin(0.4), 0.0
    return drive


def run(scene: Scene, drive: Reals) -> tuple[Reals, Reals]:
    nodes = pad(scene)
    state = contact.FingerState.rest(len(nodes.x))
    tractions, truth = contact.simulate(contact_model(scene), nodes, state, drive, np.arange(len(drive) + 1))
    return tractions, truth


@pytest.mark.parametrize("curvature", CURVATURES)
@pytest.mark.parametrize("force", [0.01, 0.5, 8.0])
def test_pressure_carries_the_commanded_force(curvature: Curvature, force: float) -> None:
    scene = Scene(curvature=curvature, tilt=(0.004, 0.003))
    tractions, truth = run(scene, drag(200, force=force))
    assert (tractions[:, 0] >= 0).all()
    np.testing.assert_allclose(truth[60:, 1], force, rtol=1e-6)


def test_steady_sliding_drags_with_the_friction_of_its_speed() -> None:
    p = Parameters(texture=0.0, damping=1.0)
    tractions, truth = run(Scene(parameters=p), drag(4000, speed=0.5))
    drag_force = np.hypot(tractions[-1, 1].sum(), tractions[-1, 2].sum()) * 0.024 * 0.016 / 48
    mu = p.kinetic_friction + (p.static_friction - p.kinetic_friction) / (1 + (0.5 / p.stribeck_speed) ** 2)
    assert drag_force == pytest.approx(mu * 2.0, rel=1e-3)
    assert truth[-1, 0] == pytest.approx(0.5, rel=1e-3)


def turned(scene: Scene, degrees: float) -> Reals:
    """The gaps of a pad that was turned in the air."""
    nodes, state = pad(scene), contact.FingerState.rest(48)
    drive = np.zeros((100, 6))
    drive[:, 2] = np.radians(degrees) / 0.1
    contact.simulate(contact_model(scene), nodes, state, drive, np.array([100]))
    return nodes.gap


def test_a_surface_turns_under_the_pad() -> None:
    """A quarter turn makes one cylinder of the other; half of one about a pivot moves the apex around it."""
    for one, other in permutations(CURVATURES[2:]):
        quarter = turned(Scene(curvature=one), 90.0)
        np.testing.assert_allclose(quarter, pad(Scene(curvature=other)).gap, atol=1e-15)
    half = turned(Scene(curvature="sphere", apex=(0.001, 0.002), offset=(0.003, -0.001)), 180.0)
    expected = pad(Scene(curvature="sphere", apex=(-0.007, 0.0))).gap
    np.testing.assert_allclose(half, expected, atol=1e-15)


def test_friction_takes_energy_out() -> None:
    """A tip that is let go while stuck or sliding never gains energy, apart from the last step's rounding."""
    scene = Scene(parameters=Parameters(texture=0.0, tilt_stiffness=1e6, static_friction=0.6))
    constants, nodes = contact_model(scene), pad(scene)
    state = contact.FingerState.rest(len(nodes.x))
    state.velocity[:] = 0.3, -0.1, 4.0
    drive = np.zeros((1, 6))
    drive[0, 3] = 2.0
    energies: list[float] = []
    for _ in range(600):
        contact.simulate(constants, nodes, state, drive, np.array([1]))
        v, e = state.velocity, state.deflection
        moving = constants.mass * (v[:2] ** 2).sum() + constants.inertia * v[2] ** 2
        strained = constants.spring * (e[:2] ** 2).sum() + constants.twist_spring * e[2] ** 2
        bristles = constants.k_t * (constants.area * state.bristle**2).sum()
        energies.append(float(moving + strained + bristles) / 2)
    start = energies[0]
    # symplectic steps keep a shadow energy: the true one ripples by about (frequency * step) of what swings
    assert max(energies) <= start * 1.01
    assert energies[-1] < 0.05 * start
