"""Ablation of the scene: the change of each measure when a term of the physics or the plan is removed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from connectors.sim.paper_plan import PaperPlan
from flows.learn.labelled_recordings import simulated_recordings
from operators.batch import Reals
from operators.detectors import Detector
from tests.scene.scene_judges import confusion, fit
from tests.scene.scene_statistics import distance, measure

NETWORK: Final = "paper's TCN, points"
DISTANCE: Final = "distance"
DETECTORS: Final = ("PSD, points", "logistic regression, points")


Change = Callable[[PaperPlan], PaperPlan]


def _physics(**values: float) -> Change:
    changes: dict[str, Any] = values
    return lambda plan: replace(plan, parameters=replace(plan.parameters, **changes))


def _plan(**values: float | tuple[float, float]) -> Change:
    changes: dict[str, Any] = values
    return lambda plan: replace(plan, **changes)


def _no_floor(plan: PaperPlan) -> PaperPlan:
    return replace(plan, parameters=replace(plan.parameters, rest_lowest=950, rest_highest=950))


def _no_stribeck(plan: PaperPlan) -> PaperPlan:
    return replace(
        plan, parameters=replace(plan.parameters, static_friction=plan.parameters.kinetic_friction)
    )


# removed in each variant
TERMS: Final[Mapping[str, Change]] = {
    "response to shear": _physics(shear_gain=0.0),
    "tilt by drag": _physics(lever=0.0),
    "texture": _physics(texture=0.0),
    "relaxation": _physics(relaxation=0.0),
    "Stribeck friction": _no_stribeck,
    "resonance of the finger (damping 1)": _physics(damping=1.0),
    "floor of the barometers": _no_floor,
    "latency of the velocity": _plan(latency=0.0),
    "arm vibration": _plan(vibration=0.0),
    "pivot off the pad's centre": _plan(pivot=0.0),
    "tilted pad on the plane": _plan(tilt=(0.0, 0.0)),
    "noise": _physics(noise=0.0),
}
# instead of 8 x 6 nodes and 1 ms
GRIDS: Final[Mapping[str, Change]] = {
    "6 x 4 nodes": _physics(columns=6, rows=4),
    "12 x 8 nodes": _physics(columns=12, rows=8),
    "steps of 0.5 ms": _physics(step=0.0005),
}


@dataclass(frozen=True, eq=False)
class Ablation:
    """Measures of the whole scene for each seed, and their change in each variant."""

    measures: tuple[str, ...]
    whole: Reals  # (seeds, measures)
    change: Mapping[str, Reals]  # (seeds, measures) of each variant

    def effect(self, name: str) -> Reals:
        """Return the mean change over the seeds; (measures,)."""
        mean: Reals = self.change[name].mean(axis=0)
        return mean

    def sigma(self, name: str) -> Reals:
        """Return the standard error of the effect, at least the median over all variants; (measures,)."""
        errors = {
            key: values.std(axis=0, ddof=1) / np.sqrt(len(values)) for key, values in self.change.items()
        }
        largest: Reals = np.maximum(errors[name], np.median(list(errors.values()), axis=0))
        return largest

    def unclear(self, names: Sequence[str]) -> list[str]:
        """Return the variants that change no measure by two sigma."""
        return [name for name in names if (np.abs(self.effect(name)) < 2 * self.sigma(name)).all()]


def ablate(
    plan: PaperPlan,
    seeds: Sequence[int],
    network: Detector | None,
    variants: Mapping[str, Change],
    *,
    hop: int = 8,
    log: Callable[[str], None] = lambda _: None,
) -> Ablation:
    """Measure the scene with and without each term, on the same seeds.

    The network's measure is its accuracy on the variant. The detectors are fitted to the variant and
    evaluated, by balanced accuracy, on other recordings of the whole scene: the loss if the training scene
    lacked the term.
    """
    judged = [simulated_recordings(plan, seed + 1000) for seed in seeds]

    def row(changed: PaperPlan, number: int) -> list[float]:
        recordings = simulated_recordings(changed, seeds[number])
        scores = [] if network is None else [confusion(network, recordings, hop).accuracy]
        found = [confusion(detector, judged[number], hop).balanced for detector in fit(recordings, hop)]
        return [*scores, distance(measure(recordings)), *found]

    def rows(name: str, changed: PaperPlan) -> Reals:
        log(name)
        return np.array([row(changed, number) for number in range(len(seeds))])

    whole = rows("the whole scene", plan)
    change = {name: rows(name, alter(plan)) - whole for name, alter in variants.items()}
    return Ablation((*([] if network is None else [NETWORK]), DISTANCE, *DETECTORS), whole, change)
