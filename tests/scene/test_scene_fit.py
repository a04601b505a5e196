from collections.abc import Iterable

import numpy as np
import pytest

from connectors.sim.barometers import DECADES, influence, respond
from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import Parameters
from operators.batch import Reals
from tests.scene.scene_fit import CONSTANTS, SLOPE, STEP, changed, constants, fit
from tests.scene.scene_targets import RELAXED, Target, relaxed

# far from the limits of friction and mass
PLAN = PaperPlan(parameters=Parameters(static_friction=1.2, kinetic_friction=0.9, texture=0.4, mass=0.08))


def test_a_step_changes_one_constant_by_its_share_and_a_tilt_by_an_angle() -> None:
    before = constants(PLAN)
    for number, name in enumerate(CONSTANTS):
        after = constants(changed(PLAN, -np.eye(len(CONSTANTS))[number]))
        expected = before[name] - SLOPE if name.startswith("tilt.") else before[name] * np.exp(-STEP)
        assert after.pop(name) == pytest.approx(expected)
        assert after == pytest.approx({key: value for key, value in before.items() if key != name})


def test_the_fit_finds_constants_that_give_the_targets_despite_noise() -> None:
    random = np.random.default_rng(0)
    hidden = random.uniform(-3, 3, len(CONSTANTS))  # steps away
    mixing = random.normal(size=(len(CONSTANTS), 40)) / 5
    start = np.array(list(constants(PLAN).values()))
    tilts = np.array([name.startswith("tilt.") for name in CONSTANTS])

    def observed(plan: PaperPlan) -> Reals:
        now = np.array(list(constants(plan).values()))
        steps = np.where(
            tilts, (now - start) / SLOPE, np.log(np.where(tilts, 1, now) / np.where(tilts, 1, start)) / STEP
        )
        return (steps - hidden) @ mixing + 0.1 * random.normal(size=40)

    def simulate(tasks: Iterable[tuple[PaperPlan, int]]) -> list[Reals]:
        return [observed(plan) for plan, _ in tasks]

    wanted = [Target(str(number), 0.0, 1.0) for number in range(40)]
    misfit = [
        np.square(observed(plan)).mean() for plan in (PLAN, fit(PLAN, wanted, simulate, 20, lambda _: None))
    ]
    assert misfit[1] < misfit[0] / 10


def test_the_relaxation_is_that_of_the_cells() -> None:
    p = PLAN.parameters
    tractions = np.zeros((401, 3, p.columns * p.rows))
    tractions[:, 0] = 1e4
    passed = 1 - np.exp(-0.01 / DECADES)
    counts = respond(tractions, influence(p), (p.sensitivity, p.relaxation), passed, np.zeros((3, 6)))[:, 0]
    left = [counts[round(100 * t)] / counts[0] for t in RELAXED]
    assert relaxed(p) == pytest.approx(left, abs=0.004)
