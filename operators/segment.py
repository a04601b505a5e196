"""Segment: connected steps of a flow, as one compiled call per batch for all of them.

Rows enter from outside, through entrances, and leave through outputs. Each fingertip has one record with the
state of all operators. `Operator.push` runs a segment of one operator; a flow fuses all that it can.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from operators.batch import EVERY, Batch, layout, pack
from operators.errors import BatchError
from operators.program import BEGIN, FINISH, GO_ON, Shape, compose
from operators.steps import RowType, Steps

Outputs: TypeAlias = list[tuple[Any, Batch]]  # key of a stage, and a batch of its output
EARLIEST: Final = int(np.iinfo(np.int64).min)  # ns


@dataclass(frozen=True)
class Stage:
    """Operator of a segment.

    Args:
        steps: Functions of the operator.
        gives: Type of its output.
        inputs: Number of the entrance, or, after all entrances, of the stage that each input comes from.
        delivers: Rows leave the segment.
        key: What its output is returned with.
    """

    steps: Steps
    gives: RowType
    inputs: tuple[int, ...]
    delivers: bool = True
    key: Any = None


@cache
def compiler() -> Callable[..., Any] | None:
    """Return `compile_program`; None: numba is not installed, so programs run as Python."""
    try:
        from operators.compilation import compile_program
    except ModuleNotFoundError as error:
        if error.name != "numba":
            raise
        return None
    return compile_program


@dataclass
class _Output:
    """Rows that leave a stage, in an array that the program fills."""

    key: Any
    kind: type[Batch]
    rows: NDArray[Any]
    stops: memoryview  # number of rows

    def take(self, finger: int) -> tuple[Any, Batch]:
        """Return a copy of the new rows, whose place is filled again."""
        stop = self.stops[0]
        if stop > len(self.rows):
            reason = "would get more rows than `held` and `factor` of its Steps allow"
            raise BatchError(self.kind.__name__, "time", reason)
        self.stops[0] = 0
        packed = np.frombuffer(self.rows[:stop].tobytes(), self.rows.dtype)
        return self.key, self.kind.unpack(packed, finger)


class Segment:
    """Running operators of one fingertip.

    Args:
        entrances: Types of the rows that enter.
        stages: Operators, each after its inputs.
        finger: Fingertip of the output.
    """

    def __init__(self, entrances: Sequence[RowType], stages: Sequence[Stage], finger: int = EVERY) -> None:
        chosen = compiler()
        shapes = tuple(
            Shape.of(each.steps, each.gives, each.inputs, each.delivers, compiled=chosen is not None)
            for each in stages
        )
        self._program = program = compose(tuple(entrances), shapes, chosen)
        self._entrances, self._finger = entrances, finger
        self._flow = cast("Any", np.zeros(1, program.flow))
        for i in range(len(entrances)):
            self._flow[f"enter{i}"]["newest"] = EARLIEST
        for i, stage in enumerate(stages):
            for record, values in (("state", stage.steps.state), ("settings", stage.steps.settings)):
                for name, value in values.items():
                    self._flow[f"{record}{i}"][name] = value
        self._memory = np.zeros(1, program.outputs)
        self._outputs = [
            _Output(
                stage.key, stage.gives.kind, self._memory[f"out{i}"][0], memoryview(self._flow[f"stop{i}"])
            )
            for i, stage in enumerate(stages)
            if stage.delivers
        ]
        self._empty = tuple(np.empty(0, entrances[i].packed) for i in program.order)
        self.pusher = cache(self._pusher)

    def _pusher(self, *entrances: int) -> Callable[..., Outputs]:
        """Return a function that lets batches in and returns the output.

        Args:
            entrances: Entrance of each batch. The batches are slices of one time span.
        """
        flow, given = self._flow, self._entrances
        chosen = self._program.order if len(entrances) > 1 else entrances
        drive, empty = self._program.drives[chosen], [np.empty(0, given[i].packed) for i in chosen]
        places = [(chosen.index(i), given[i].packed, given[i]) for i in entrances]
        taken, memory = self._taken, self._memory

        def push(*batches: Batch) -> Outputs:
            parts = [*empty]
            for (place, row, kind), batch in zip(places, batches, strict=True):
                packed = batch.packed
                parts[place] = packed if packed.dtype is row else _packed(batch, kind)
            rows = tuple(parts)
            waiting = drive(flow, memory, rows, BEGIN)
            return taken(waiting, drive, rows) if waiting else []

        return push

    def flush(self) -> Outputs:
        """End all streams and return the last output."""
        drive = self._program.drives[self._program.order]
        return self._taken(drive(self._flow, self._memory, self._empty, FINISH), drive, self._empty)

    @property
    def late(self) -> int:
        """Number of late rows that entered."""
        return sum(int(self._flow[f"enter{i}"]["late"][0]) for i in range(len(self._entrances)))

    def _taken(self, waiting: int, drive: Callable[..., int], rows: tuple[NDArray[Any], ...]) -> Outputs:
        """Return the rows that wait, and let in those that the call left."""
        outputs: Outputs = []
        while True:
            outputs += [each.take(self._finger) for each in self._outputs if each.stops[0]]
            if waiting >= 0:
                return outputs
            waiting = drive(self._flow, self._memory, rows, GO_ON)


def _packed(batch: Batch, given: RowType) -> NDArray[Any]:
    """Return the packed rows of a batch, of the type of an entrance."""
    if not len(batch):  # of any number of cells
        return np.empty(0, given.packed)
    if batch.cells not in {0, given.cells}:
        reason = f"has {batch.cells} cells, but the fingertip was described or begun with {given.cells}"
        raise BatchError(type(batch).__name__, str(layout(type(batch)).cell_column), reason)
    return batch.packed if batch.packed.dtype == given.packed else pack(batch, given.packed)
