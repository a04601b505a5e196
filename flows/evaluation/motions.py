"""How well slip is recognised in each kind of motion, beside the paper's Table III."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from flows.evaluation.metrics import Confusion
from flows.trials import Trial
from operators.batch import Flags, Reals

SURFACES: Final = ("plane", "sphere", "cylinder_y", "cylinder_x")
SPEEDS: Final = (0.05, 0.075, 0.1)  # m/s
PAPER: Final[Mapping[tuple[str, float | None], tuple[float, ...]]] = {
    ("primary", 0.05): (92.5, 88.8, 78.7, 94.0, 89.7),
    ("primary", 0.075): (94.9, 88.0, 90.0, 90.3, 91.6),
    ("primary", 0.1): (95.7, 84.5, 87.8, 92.1, 93.1),
    ("oblique", 0.05): (94.0, 88.9, 87.1, 93.2, 91.5),
    ("oblique", 0.075): (96.6, 89.3, 93.7, 92.2, 93.1),
    ("oblique", 0.1): (96.4, 88.6, 93.5, 93.4, 93.8),
    ("rotation", None): (84.6, 74.5, 84.0, 86.1, 81.5),
}  # F1, %, on each of `SURFACES` and on all
PAPER_SURFACES: Final = (94.0, 88.9, 88.0, 91.9)  # F1, %, any motion


@dataclass(frozen=True, slots=True)
class Cell:
    """A kind of motion on a surface."""

    kind: str  # primary, oblique or rotation
    speed: float | None  # m/s; None: rotation
    surface: str


Chosen = Callable[[Cell], bool]


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A detector's answers, counted by recording and by axis of the stroke."""

    cells: tuple[Cell, ...]  # (k,)
    trials: NDArray[np.intp]  # (k,) the recording that each is of
    counts: Reals  # (k, 2, 2) as in `Confusion`

    @classmethod
    def of(cls, trials: Sequence[Trial], judged: Sequence[NDArray[np.intp]], called: Sequence[Flags]) -> Self:
        """Count answers; those to recordings whose strokes are not known are left out.

        Args:
            trials: (m,)
            judged: the samples of each trial that are judged, (j,) each
            called: whether each of these is called slip, (j,) each
        """
        cells, numbers, counts = list[Cell](), list[int](), list[Reals]()
        for number, (trial, at, slip) in enumerate(zip(trials, judged, called, strict=True)):
            if trial.oblique is None:
                continue
            oblique = trial.oblique[at]
            kinds = (("primary", ~oblique), ("oblique", oblique))
            for kind, part in kinds if trial.speed else (("rotation", oblique | ~oblique),):
                cells.append(Cell(kind, trial.speed, trial.surface))
                numbers.append(number)
                counts.append(Confusion.of(slip[part], trial.slip[at][part]).counts)
        return cls(tuple(cells), np.array(numbers, np.intp), np.array(counts).reshape(-1, 2, 2))

    def confusion(self, chosen: Chosen = lambda _: True) -> Confusion:
        """All the chosen together."""
        return Confusion(self.counts[[chosen(cell) for cell in self.cells]].sum(axis=0))

    def at(self, cell: Cell) -> Confusion:
        """One cell."""
        return self.confusion(cell.__eq__)

    def gap(self, first: Chosen, second: Chosen, seed: int = 0, draws: int = 300) -> tuple[float, float]:
        """F1 of the first less that of the second, and its standard error by a bootstrap over recordings.

        NaN where one of them is empty.
        """
        sides = [
            self.counts * np.array([side(cell) for cell in self.cells])[:, None, None]
            for side in (first, second)
        ]
        number = int(self.trials[-1]) + 1
        random = np.random.default_rng(seed)

        def gap(weights: Reals) -> float:  # (recordings,)
            one, other = (Confusion((side * weights[self.trials, None, None]).sum(axis=0)) for side in sides)
            return one.f1 - other.f1

        whole = gap(np.ones(number))
        if np.isnan(whole):
            return whole, whole

        shares = np.full(number, 1 / number)
        drawn = [gap(np.asarray(random.multinomial(number, shares), np.float64)) for _ in range(draws)]
        return whole, float(np.nanstd(drawn))
