"""How well slip is recognised in each kind of motion on each surface, as in the paper's Table III."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording
from operators.batch import Flags, Reals


@dataclass(frozen=True, slots=True)
class Cell:
    """A kind of motion on a surface."""

    kind: str  # primary, oblique or rotation
    speed: float | None  # m/s; None: rotation
    surface: str


Chosen: TypeAlias = Callable[[Cell], bool]  # whether a cell belongs to a group


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A detector's answers, counted by recording and by axis of the stroke."""

    cells: tuple[Cell, ...]  # (k,)
    recordings: NDArray[np.intp]  # (k,) the recording that each is of
    counts: Reals  # (k, 2, 2) as in `Confusion`

    @classmethod
    def of(
        cls,
        recordings: Sequence[LabelledRecording],
        judged: Sequence[NDArray[np.intp]],
        called: Sequence[Flags],
    ) -> Self:
        """Count answers; those to recordings whose strokes are not known are left out.

        Args:
            recordings: (m,)
            judged: the samples of each recording that are judged, (j,) each
            called: whether each of these is called slip, (j,) each
        """
        cells, numbers, counts = list[Cell](), list[int](), list[Reals]()
        for number, (recording, at, slip) in enumerate(zip(recordings, judged, called, strict=True)):
            if recording.oblique is None:
                continue
            oblique = recording.oblique[at]
            kinds = (("primary", ~oblique), ("oblique", oblique))
            for kind, part in kinds if recording.speed else (("rotation", oblique | ~oblique),):
                cells.append(Cell(kind, recording.speed, recording.surface))
                numbers.append(number)
                counts.append(Confusion.of(slip[part], recording.slip[at][part]).counts)
        return cls(tuple(cells), np.array(numbers, np.intp), np.array(counts).reshape(-1, 2, 2))

    def confusion(self, chosen: Chosen = lambda _: True) -> Confusion:
        """The answers in all chosen cells together."""
        return Confusion(self.counts[[chosen(cell) for cell in self.cells]].sum(axis=0))

    def at(self, cell: Cell) -> Confusion:
        """The answers in one cell."""
        return self.confusion(cell.__eq__)

    def gap(self, first: Chosen, second: Chosen, seed: int = 0, draws: int = 300) -> tuple[float, float]:
        """F1 of the first less that of the second, and its standard error by a bootstrap over recordings.

        NaN where one of them is empty.
        """
        sides = [
            self.counts * np.array([side(cell) for cell in self.cells])[:, None, None]
            for side in (first, second)
        ]
        number = int(self.recordings[-1]) + 1
        random = np.random.default_rng(seed)

        def gap(weights: Reals) -> float:  # (recordings,)
            one, other = (
                Confusion((side * weights[self.recordings, None, None]).sum(axis=0)) for side in sides
            )
            return one.f1 - other.f1

        whole = gap(np.ones(number))
        if np.isnan(whole):
            return whole, whole

        shares = np.full(number, 1 / number)
        drawn = [gap(np.asarray(random.multinomial(number, shares), np.float64)) for _ in range(draws)]
        return whole, float(np.nanstd(drawn))
