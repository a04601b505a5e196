"""Speed of the simulation: simulated seconds per CPU second of one core."""

from dataclasses import dataclass, replace
from time import process_time
from typing import Final

from connectors.sim.finger import Finger
from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import Scene, Strokes

GRIDS: Final = ((6, 4), (8, 6), (12, 8))  # columns and rows of nodes
FINGERTIPS: Final = (1, 2, 4, 8, 16)


@dataclass(frozen=True, slots=True)
class Speed:
    """Simulated seconds per CPU second."""

    by_nodes: dict[int, float]  # one fingertip
    by_fingertips: dict[int, float]  # of the whole scene with all its fingertips
    single: float  # one fingertip, sample by sample, as in a live run


def speed(plan: PaperPlan, seconds: float) -> Speed:
    """Time the plan's fingertip on endless strokes over `seconds` of simulated time, the best of three."""
    parameters = plan.parameters
    scene = Scene(Strokes(), parameters=parameters)
    by_nodes = {
        columns * rows: _best(
            replace(scene, parameters=replace(parameters, columns=columns, rows=rows)), seconds
        )
        for columns, rows in GRIDS
    }
    by_fingertips = {number: _best(scene, seconds / 4, number) for number in FINGERTIPS}
    return Speed(by_nodes, by_fingertips, _best(scene, seconds / 4, stretch=1))


def _best(scene: Scene, seconds: float, fingertips: int = 1, stretch: int | None = None) -> float:
    samples = max(round(seconds * scene.touch.rate), 1)
    stretch = stretch or samples
    times = list[float]()
    for _ in range(3):
        fingers = [Finger(scene, 0, number) for number in range(fingertips)]
        begin = process_time()
        for finger in fingers:
            for _ in range(samples // stretch):
                finger.take(stretch)
        times.append(process_time() - begin)
    return samples / scene.touch.rate / max(min(times), 1e-9)
