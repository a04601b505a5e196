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


class _Output:
    """Rows that leave a stage, in an array that the program fills."""

    def __init__(self, stage: Stage, rows: NDArray[Any], stops: memoryview, finger: int) -> None:
        self.stops, self._key, self._kind, self._rows = stops, stage.key, stage.gives.kind, rows
        self._finger = finger

    def take(self, stop: int) -> tuple[Any, Batch]:
        """Return a copy of the rows, whose place is filled again."""
        if stop > len(self._rows):
            reason = "would get more rows than `held` and `factor` of its Steps allow"
            raise BatchError(self._kind.__name__, "time", reason)
        self.stops[0] = 0
        rows = np.frombuffer(self._rows[:stop].tobytes(), self._rows.dtype)
        return self._key, self._kind.unpack(rows, self._finger)


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
        self._entrances = entrances
        self._flow, self._memory = cast("Any", np.zeros(1, program.flow)), np.zeros(1, program.outputs)
        for i in range(len(entrances)):
            self._flow[f"enter{i}"]["newest"] = EARLIEST
        for i, stage in enumerate(stages):
            for record, values in (("state", stage.steps.state), ("settings", stage.steps.settings)):
                for name, value in values.items():
                    self._flow[f"{record}{i}"][name] = value
        self._outputs = [
            _Output(stage, self._memory[f"out{i}"][0], memoryview(self._flow[f"stop{i}"]), finger)
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
        flow, memory, given, taken = self._flow, self._memory, self._entrances, self._taken
        used = self._program.order if len(entrances) > 1 else entrances
        drive, empty = self._program.drives[used], [np.empty(0, given[i].packed) for i in used]
        places = [(used.index(i), given[i].packed, given[i]) for i in entrances]
        [(_, only_row, only_kind), *_] = places
        only = self._outputs[0] if len(self._outputs) == 1 else None

        def push(*batches: Batch) -> Outputs:
            parts = [*empty]
            for (place, row, kind), batch in zip(places, batches, strict=True):
                packed = batch.packed
                parts[place] = packed if packed.dtype is row else _packed(batch, kind)
            rows = tuple(parts)
            waiting = drive(flow, memory, rows, BEGIN)
            if waiting > 0 and only:
                return [only.take(waiting)]
            return taken(waiting, drive, rows) if waiting else []

        def push_one(batch: Batch) -> Outputs:
            packed = batch.packed
            rows = (packed if packed.dtype is only_row else _packed(batch, only_kind),)
            waiting = drive(flow, memory, rows, BEGIN)
            if waiting > 0 and only:
                return [only.take(waiting)]
            return taken(waiting, drive, rows) if waiting else []

        return push_one if len(entrances) == 1 else push

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
            outputs += [each.take(stop) for each in self._outputs if (stop := each.stops[0])]
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
