"""Detection of slip by kind of motion and surface, as in the paper's Table III."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from flows.learn.evaluation.sample_metrics import confusion, f1
from flows.learn.labelled_recordings import LabelledRecording
from operators.batch import Flags, Reals


@dataclass(frozen=True, slots=True)
class MotionKind:
    """Kind of motion on a surface."""

    kind: str  # primary, oblique or rotation
    speed: float | None  # m/s; None: rotation
    surface: str


MotionGroup: TypeAlias = Callable[[MotionKind], bool]  # True for the kinds in the group


@dataclass(frozen=True, slots=True, eq=False)
class MotionConfusions:
    """Predictions of a detector, counted by recording and by axis of the stroke."""

    kinds: tuple[MotionKind, ...]  # (k,)
    recordings: NDArray[np.intp]  # (k,) index of the recording
    counts: Reals  # (k, 2, 2) as of `confusion`

    @classmethod
    def of(
        cls,
        recordings: Sequence[LabelledRecording],
        evaluated: Sequence[NDArray[np.intp]],
        predicted: Sequence[Flags],
    ) -> Self:
        """Count predictions, except in recordings whose strokes are unknown.

        Args:
            recordings: (m,)
            evaluated: the evaluated samples of each recording, (j,) each
            predicted: True where these are predicted as slip, (j,) each
        """
        found, numbers, counts = list[MotionKind](), list[int](), list[Reals]()
        for number, (recording, at, slip) in enumerate(zip(recordings, evaluated, predicted, strict=True)):
            if (strokes := recording.strokes) is None:
                continue
            oblique = strokes.oblique[at]
            kinds = (("primary", ~oblique), ("oblique", oblique))
            for kind, part in kinds if strokes.speed else (("rotation", oblique | ~oblique),):
                found.append(MotionKind(kind, strokes.speed, strokes.surface))
                numbers.append(number)
                counts.append(confusion(slip[part], recording.slip[at][part]))
        return cls(tuple(found), np.array(numbers, np.intp), np.array(counts).reshape(-1, 2, 2))

    def f1(self, group: MotionGroup = lambda _: True) -> float:
        """Return the F1 of the predictions in a group of kinds."""
        return float(f1(self.counts[[group(kind) for kind in self.kinds]].sum(axis=0)))
