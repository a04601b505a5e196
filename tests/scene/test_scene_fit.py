from collections.abc import Iterable

import numpy as np

from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import Parameters
from operators.batch import Reals
from tests.scene.scene_fit import CONSTANTS, SLOPE, STEP, constants, fit
from tests.scene.scene_targets import Target

# far from the limits of friction and mass
PLAN = PaperPlan(parameters=Parameters(static_friction=1.2, kinetic_friction=0.9, texture=0.4, mass=0.08))


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
