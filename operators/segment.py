"""Segment: connected steps of a flow, as one compiled call per batch for all of them.

Rows enter from outside, through entrances, and leave by outlets. Each fingertip has one record with the state
of all operators. `Operator.push` runs a segment of one operator; a flow fuses all that it can.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from operators.batch import EVERY, Batch, layout, pack
from operators.errors import BatchError
from operators.program import LATEST, Shape, compose
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


class Segment:
    """Running operators of one or more fingertips.

    Args:
        entrances: Types of the rows that enter.
        stages: Operators, each after its inputs.
        fingers: Fingertips.
    """

    def __init__(
        self, entrances: Sequence[RowType], stages: Sequence[Stage], fingers: Sequence[int] = (EVERY,)
    ) -> None:
        self._stages, self._fingers, self._entrances = tuple(stages), tuple(fingers), tuple(entrances)
        self._pushers = dict[tuple[int, tuple[int, ...]], Callable[..., Outputs]]()
        shapes = (Shape.of(each.steps, each.gives, each.inputs, each.delivers) for each in stages)
        program = compose(self._entrances, tuple(shapes), compiler())
        self._drive, self._order, self._rows = program.drive, program.order, program.rows
        self._block: Any = np.zeros(len(fingers), program.block)
        self._settings: Any = np.zeros(1, program.settings)
        for i in range(len(entrances)):
            self._block[f"enter{i}"]["newest"] = EARLIEST
        for i, stage in enumerate(stages):
            for records, values in ((self._block, stage.steps.state), (self._settings, stage.steps.settings)):
                for name, value in values.items():
                    records[f"stage{i}"][name] = value
        self._empty = tuple(np.empty(0, entrances[i].packed) for i in self._order)

    def pusher(self, finger: int, *entrances: int) -> Callable[..., Outputs]:
        """Return a function that lets batches in and returns the output.

        Args:
            finger: Fingertip of the batches; one that is none of the segment's: all.
            entrances: Entrance of each batch. The batches are slices of one time span.
        """
        if (known := self._pushers.get((finger, entrances))) is None:
            known = self._pushers[finger, entrances] = self._pusher(*self._slots(finger), entrances)
        return known

    def _pusher(self, first: int, last: int, entrances: tuple[int, ...]) -> Callable[..., Outputs]:
        drive, settings, block = self._drive, self._settings, self._block
        collect = self._collector(first, last)
        places = [self._order.index(entrance) for entrance in entrances]
        types = [self._entrances[entrance].packed for entrance in entrances]
        empty = self._empty

        def let_in(rows: Sequence[NDArray[Any]]) -> Outputs:
            if sum(map(len, rows)) > self._rows:
                return [output for part in self._halves(rows) for output in let_in(part)]
            return collect() if drive(settings, block, first, last, tuple(rows), False) else []

        def push(*batches: Batch) -> Outputs:
            rows = [*empty]
            for place, row, batch in zip(places, types, batches, strict=True):
                packed = batch.packed
                rows[place] = packed if packed.dtype is row else self._packed(batch, place)
            return let_in(rows)

        if len(entrances) > 1:
            return push
        before, after, row = empty[: places[0]], empty[places[0] + 1 :], types[0]

        def push_one(batch: Batch) -> Outputs:
            rows = batch.packed
            if rows.size > 1 or rows.dtype is not row:
                return push(batch)
            waiting = drive(settings, block, first, last, (*before, rows, *after), False)
            return collect() if waiting else []

        return push_one

    def _halves(self, rows: Sequence[NDArray[Any]]) -> tuple[list[NDArray[Any]], list[NDArray[Any]]]:
        """Divide rows that are too many for one call: first those of the earlier half of the time span."""
        reached = [np.maximum.accumulate(each["time"]) for each in rows]
        longest = max(reached, key=len)
        side: Literal["left", "right"] = "right" if longest[len(longest) // 2] < longest[-1] else "left"
        cuts = [int(times.searchsorted(longest[len(longest) // 2], side)) for times in reached]
        if not any(cuts):  # many rows of the first time: those of the first entrance come first
            place = min(range(len(rows)), key=lambda i: reached[i][0] if len(rows[i]) else LATEST)
            cuts[place] = min(self._rows, int(reached[place].searchsorted(reached[place][0], "right")))
        earlier = [each[:cut] for each, cut in zip(rows, cuts, strict=True)]
        return earlier, [each[cut:] for each, cut in zip(rows, cuts, strict=True)]

    def flush(self) -> Outputs:
        """End all streams and return the last output."""
        slots = 0, len(self._fingers)
        if self._drive(self._settings, self._block, *slots, self._empty, True):
            return self._collector(*slots)()
        return []

    @property
    def late(self) -> int:
        """Number of late rows that entered, of the first fingertip."""
        return sum(int(self._block[f"enter{i}"]["late"][0]) for i in range(len(self._entrances)))

    def _slots(self, finger: int) -> tuple[int, int]:
        if finger in self._fingers:
            slot = self._fingers.index(finger)
            return slot, slot + 1
        return 0, len(self._fingers)

    def _packed(self, batch: Batch, place: int) -> NDArray[Any]:
        """Return the packed rows of a batch, of the type of an entrance."""
        if not len(batch):  # of any number of cells
            return self._empty[place]
        given = self._entrances[self._order[place]]
        if batch.cells not in {0, given.cells}:
            reason = f"has {batch.cells} cells, but the fingertip is described with {given.cells}"
            raise BatchError(type(batch).__name__, str(layout(type(batch)).cell_column), reason)
        return batch.packed if batch.packed.dtype == given.packed else pack(batch, given.packed)

    def _collector(self, first: int, last: int) -> Callable[[], Outputs]:
        """Return a function that copies the rows that wait in the outlets of some fingertips."""
        outlets = list[Any]()
        for i, stage in enumerate(self._stages):
            for slot in range(first, last) if stage.delivers else ():
                start = self._block.dtype.fields[f"out{i}"][1]
                room = self._block[f"out{i}"][slot].nbytes
                record: Any = self._block[slot : slot + 1].view(np.uint8)
                memory, counts = memoryview(record)[start : start + room], self._block[f"count{i}"]
                outlets.append((stage, counts, slot, memory, stage.gives.packed, room))
        fingers, new, packed = self._fingers, object.__new__, np.frombuffer

        def collect() -> Outputs:
            outputs: Outputs = []
            for stage, counts, slot, memory, row, room in outlets:
                if count := counts.item(slot):
                    size = count * row.itemsize
                    if size > room:
                        reason = "would get more rows than `held` and `factor` of its Steps allow"
                        raise BatchError(stage.gives.kind.__name__, "time", reason)
                    batch = new(stage.gives.kind)
                    batch.packed, batch.finger = packed(bytes(memory[:size]), row), fingers[slot]
                    outputs.append((stage.key, batch))
            return outputs

        return collect
