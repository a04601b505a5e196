"""Targets of the fit of the scene: real and published figures, and the same figures of a simulated plan."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.sim.barometers import DECADES
from connectors.sim.finger import simulate_scene
from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import Parameters
from flows.learn.evaluation.published import SURFACES, TABLE_3, TABLE_3_ANY
from flows.learn.labelled_recordings import LabelledRecording, scene_seed, simulated_recordings
from flows.learn.measures import confusion, f1
from operators import FaultKind, Health
from operators.batch import UNKNOWN, Faults, Flags, Reals, Touch, concat
from operators.detectors import Detector
from operators.errors import InputError
from tests.scene.scene_statistics import FREQUENCIES, TABLE, measure

PLAN: Final = PaperPlan(repeats=2, rotations=2)  # that the constants are fitted on
CROSS_CHECK: Final = (1, 2, 3)  # seeds that the fit does not use
HOP: Final = 20  # samples between evaluated samples
# Part of the response that is left after t (s) at held depth: mean of three recordings of barometers under
# rubber (T-RO 2025, 10.1109/TRO.2024.3508315): vac_zv1_zd6_t20, vac_zv3_zd6_t8, zv1_zd6_t8
RELAXED: Final[Mapping[float, float]] = {0.25: 0.966, 1.0: 0.925, 4.0: 0.872}
FAULTY: Final = 0.5  # %, largest share of samples with a fault or a saturated cell


class MotionKind(NamedTuple):
    """Kind of motion on a surface, as in the paper's Table III."""

    kind: str  # primary, oblique or rotation
    speed: float | None  # m/s; None: rotation
    surface: str


MotionGroup: TypeAlias = Callable[[MotionKind], bool]  # True for the kinds in the group


@dataclass(frozen=True, slots=True)
class Target:
    """A figure that the scene should have."""

    text: str
    real: float
    weight: float  # misfit per unit of difference


def targets(trace: LabelledRecording) -> list[Target]:
    """Return the targets, in the order of `figures`."""
    kinds, of_surface = groups(), 4  # the first of them are surfaces
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
    faulty = [
        degraded(simulate_scene(scene, scene_seed(seed, n))[0]) for n, scene in enumerate(plan.scenes(seed))
    ]
    counted = [count for each in recordings for count in confusions(each, network)]
    statistics = measure(recordings)

    return np.array(
        [
            *(
                f1(np.sum([count for kind, count in counted if group(kind)], axis=0))
                for _, group, _ in groups()
            ),
            *(row.distance(statistics[row.key]) for row in TABLE if row.low),
            *relaxed(plan.parameters),
            *_shape(statistics),
            max(100 * np.concatenate(faulty).mean(), FAULTY),
        ]
    )


def confusions(recording: LabelledRecording, network: Detector) -> Iterator[tuple[MotionKind, Reals]]:
    """Yield the predictions by kind of motion, counted as `confusion` does; none if strokes are unknown."""
    at = recording.known(HOP)
    slip = network.score(recording.windows(network.length, HOP)) > 1 / 2
    if (strokes := recording.strokes) is not None:
        oblique = strokes.oblique[at]
        kinds = (("primary", ~oblique), ("oblique", oblique))
        for kind, part in kinds if strokes.speed else (("rotation", oblique | ~oblique),):
            counts = confusion(slip[part], recording.slip[at][part])
            yield MotionKind(kind, strokes.speed, strokes.surface), counts


def degraded(touch: Touch, *but: FaultKind) -> Flags:
    """Return True at each sample at which `Health` reports a fault of another kind than some; (n,)."""
    health = Health()
    faults = concat(Faults, [health.push(touch), health.flush()])
    faults = faults[~np.isin(faults.kind, but)]
    number = np.concatenate(([0], np.where(faults.active, 1, -1).cumsum()))  # of faults, after each change
    active: Flags = number[faults.time.searchsorted(touch.time, "right")] > 0
    return active


def read_trace(path: Path) -> LabelledRecording:
    """Read a real trace.

    Raises:
        InputError: if a row has no label, or the file is not a trace.
    """
    part = Trace(path, ColumnMap(zeroed=True)).part
    if (part.labels == UNKNOWN).any():
        raise InputError(str(path), "has rows without a label; label each row")
    return LabelledRecording(part.touch.counts, part.labels, name=path.stem)


def relaxed(parameters: Parameters) -> list[float]:
    """Return the part of the response that is left at the times of `RELAXED`."""
    return [1 - parameters.relaxation * float((1 - np.exp(-t / DECADES)).sum()) for t in RELAXED]


def _shape(statistics: Mapping[str, Reals]) -> list[float]:
    """Return the shape of the spectrum in slip: amplitudes in octaves from their mean."""
    octaves = np.log2(statistics["slip spectrum"])
    shape: list[float] = (octaves - octaves.mean()).tolist()
    return shape


def groups() -> list[tuple[str, MotionGroup, float]]:
    """Return the groups of windows that the paper has figures for: name, cells, F1 (%)."""

    def on(surface: str) -> MotionGroup:
        return lambda cell: cell.surface == surface

    def moved(kind: str, pace: float | None) -> MotionGroup:
        return lambda cell: (cell.kind, cell.speed) == (kind, pace)

    surfaces = [(s.replace("_", " "), on(s), f1) for s, f1 in zip(SURFACES, TABLE_3_ANY, strict=True)]
    motions = [(_motion_name(*motion), moved(*motion), f1[-1]) for motion, f1 in TABLE_3.items()]
    return [*surfaces, *motions]


def _motion_name(kind: str, pace: float | None) -> str:
    """Return kind and speed of a motion as text."""
    return f"{kind}, 1 rad/s" if pace is None else f"{kind}, {100 * pace:g} cm/s"
