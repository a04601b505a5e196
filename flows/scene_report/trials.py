"""What a detector and a statistic get to see of simulated and of real recordings: counts and labels."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from connectors import CsvTrace
from connectors.rig.finger import Finger
from connectors.rig.motion import Controller
from connectors.rig.paper import Collection
from connectors.rig.scene import Move, Scene
from connectors.rig.truth import Truth
from operators import Align, Label, Zero, ms
from operators.batch import SLIP, UNKNOWN, Counts, Flags, Labelled, Motion, Reals, Touch, concat, s
from operators.errors import InputError

JUDGED: Final = 99  # samples before the first that is judged: what the longest window needs
_STRETCH: Final = 3000  # samples simulated at once


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One recording of one fingertip at 100 Hz."""

    counts: Counts  # (n, 6) zeroed
    slip: Flags  # (n,) by the arm's speed, as the paper labels
    surface: str
    speed: float | None = None  # m/s of its strokes; None: rotations
    oblique: Flags | None = None  # (n,) whether the latest stroke crosses both axes of the fingertip
    force: Reals | None = None  # (n,) N, normal: the simulation's truth, for the eye only
    zeroing: int = 0  # samples that it begins with and that the baseline was taken from

    def __len__(self) -> int:
        return len(self.slip)

    def judged(self, hop: int) -> NDArray[np.intp]:
        """The samples that detectors are judged by: each `hop`-th that has a second of signal behind it."""
        return np.arange(JUDGED, len(self), hop)


def simulate(collection: Collection, seed: int) -> list[Trial]:
    """Every recording of a plan."""
    return [
        trial(scene, int(np.random.SeedSequence([seed, n]).generate_state(1)[0]))
        for n, scene in enumerate(collection.scenes(seed))
    ]


def trial(scene: Scene, seed: int) -> Trial:
    """One scene as the project's own operators see it: zeroed, aligned in event time, labelled by speed."""
    moves: list[tuple[float, Move]] = []
    finger = Finger(scene, seed, begun=lambda move, start: moves.append((start, move)))
    controller = Controller(scene, seed)
    taken = list(iter(lambda: finger.take(_STRETCH), None))
    motion = concat(Motion, list(iter(lambda: controller.take(_STRETCH), None)))
    truth = concat(Truth, [happened for _, happened in taken])
    zero, align, label = Zero(), Align(within=20 * ms), Label(rotation=0.2)
    zeroed = zero.push(concat(Touch, [touch for touch, _ in taken]))
    samples = [align.push(zeroed, motion), align.flush()]
    labelled = concat(Labelled, [label.push(batch) for batch in samples])
    strokes = [(start, move) for start, move in moves if move.motion in ("translation", "rotation")]
    starts = np.array([start for start, _ in strokes]) * s
    across = np.array([move.axis == "oblique" for _, move in strokes] + [False])
    latest = np.searchsorted(starts, truth.time, "right") - 1  # (n,) -1 before the first
    speeds = [move.speed for _, move in strokes if move.motion == "translation"]
    return Trial(
        labelled.counts,
        labelled.label == SLIP,
        scene.curvature,
        speeds[0] if speeds else None,
        across[latest],
        truth.force,
        zero.scans,
    )


def read(path: Path) -> Trial:
    """A real trace.

    Raises:
        InputError: if it has no labels, or is no trace.
    """
    trace = CsvTrace(path, zeroed=True)
    if (trace.labels == UNKNOWN).any():
        raise InputError(str(path), "has no label in every row")
    return Trial(trace.touch.counts, trace.labels == SLIP, path.stem)
