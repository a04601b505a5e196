"""Targets of the fit of the scene: real and published figures, and the same figures of a simulated plan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from connectors.sim.barometers import DECADES
from connectors.sim.paper_plan import PaperPlan
from connectors.sim.physics_parameters import Parameters
from flows.learn.evaluation.motion_metrics import MotionConfusions
from flows.learn.labelled_recordings import LabelledRecording, simulated_recordings
from flows.learn.scoring import windows
from flows.report.table import Table, Value
from operators.batch import Reals
from operators.detectors import Detector
from tests.scene.scene_motion import groups
from tests.scene.scene_statistics import FREQUENCIES, TABLE, measure

PLAN: Final = PaperPlan(repeats=2, rotations=2)  # that the constants are fitted on
CROSS_CHECK: Final = (1, 2, 3)  # seeds that the fit does not use
HOP: Final = 20  # samples between evaluated samples
# Part of the response that is left after t (s) at held depth: mean of three recordings of barometers under
# rubber (T-RO 2025, 10.1109/TRO.2024.3508315): vac_zv1_zd6_t20, vac_zv3_zd6_t8, zv1_zd6_t8
RELAXED: Final[Mapping[float, float]] = {0.25: 0.966, 1.0: 0.925, 4.0: 0.872}
FAULTY: Final = 0.5  # %, largest share of samples with a fault or a saturated cell


@dataclass(frozen=True, slots=True)
class Target:
    """A figure that the scene should have."""

    text: str
    real: float
    weight: float  # misfit per unit of difference


def targets(trace: LabelledRecording) -> list[Target]:
    """Return the targets, in the order of `figures`."""
    _, *kinds = groups()
    of_surface = 4  # the first of them are surfaces
    return [
        *(Target(f"F1, {name}, %", f1, 0.6) for name, _, f1 in kinds[:of_surface]),
        *(Target(f"F1, {name}, %", f1, 0.4) for name, _, f1 in kinds[of_surface:]),
        *(Target(f"distance: {row.text}", 0.0, 6.0) for row in TABLE if row.low),
        *(Target(f"response left after {t:g} s at held depth", part, 50.0) for t, part in RELAXED.items()),
        *(
            Target(f"slip at {frequency:g} Hz, octaves from the mean of four", value, 0.5)
            for frequency, value in zip(FREQUENCIES, _shape(measure([trace])), strict=True)
        ),
        Target("samples with a fault or a saturated cell, %", FAULTY, 1.0),
    ]


def figures(plan: PaperPlan, seed: int, network: Detector) -> Reals:
    """Simulate a plan; return its figures, in the order of `targets`."""
    recordings = simulated_recordings(plan, seed)
    evaluated = [each.evaluated(HOP) for each in recordings]
    slip = [network.score(windows(each, network.length, HOP)) > 1 / 2 for each in recordings]
    found = MotionConfusions.of(recordings, evaluated, slip)
    statistics = measure(recordings)
    degraded = np.concatenate([each.degraded for each in recordings if each.degraded is not None])
    return np.array(
        [
            *(found.confusion(group).f1 for _, group, _ in groups()[1:]),
            *(row.distance(statistics[row.key]) for row in TABLE if row.low),
            *relaxed(plan.parameters),
            *_shape(statistics),
            max(100 * degraded.mean(), FAULTY),
        ]
    )


def target_table(plan: PaperPlan, seeds: Sequence[int], network: Detector, trace: LabelledRecording) -> Table:
    """Return the targets, and the mean figures of a plan over seeds."""
    found = np.mean([figures(plan, seed, network) for seed in seeds], axis=0)
    rows: list[list[Value]] = [
        [each.text, each.weight, each.real, value]
        for each, value in zip(targets(trace), found.tolist(), strict=True)
    ]
    head = ["target of the fit", "weight", "real", "simulated"]
    caption = f"Targets of `make scene-fit`, and the scene on {len(seeds)} seeds that the fit does not use"
    return Table(head, rows, caption, dict.fromkeys(head))


def relaxed(parameters: Parameters) -> list[float]:
    """Return the part of the response that is left at the times of `RELAXED`."""
    return [1 - parameters.relaxation * float((1 - np.exp(-t / DECADES)).sum()) for t in RELAXED]


def _shape(statistics: Mapping[str, Reals]) -> list[float]:
    """Return the shape of the spectrum in slip: amplitudes in octaves from their mean."""
    octaves = np.log2(statistics["slip spectrum"])
    shape: list[float] = (octaves - octaves.mean()).tolist()
    return shape
