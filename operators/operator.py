"""Base classes of operators and joins.

Invariant of every operator: **cutting the input anywhere changes nothing**. However a stream is cut into
batches, the concatenated output is identical, bit for bit.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Generic, Never, NoReturn, Self, TypeVar, cast, get_args

import numpy as np

from operators.batch import EVERY, Batch, layout
from operators.errors import InputError
from operators.fingertip import Fingertip
from operators.segment import EARLIEST, Outputs, Segment, Stage
from operators.steps import RowType, Steps

In = TypeVar("In", bound=Batch, contravariant=True)
Left = TypeVar("Left", bound=Batch, contravariant=True)
Right = TypeVar("Right", bound=Batch, contravariant=True)
Out = TypeVar("Out", bound=Batch, covariant=True)
SomeBatch = TypeVar("SomeBatch", bound=Batch)


@dataclass
class LateRowFilter:
    """Filter that drops and counts late rows: rows older than the newest one before them."""

    newest: int = EARLIEST  # ns
    late: int = 0  # rows

    def filter(self, batch: SomeBatch) -> SomeBatch:
        """Return the rows that are not late; rows with equal stamps keep their order of arrival."""
        time = batch.time
        if not time.size:
            return batch
        first = time.item(0)
        if first >= self.newest and (time.size == 1 or batch.is_ordered()):
            self.newest = first if time.size == 1 else time.item(-1)
            return batch
        limit = np.maximum.accumulate(np.maximum(time, self.newest))  # (n,)
        kept = time >= limit  # (n,)
        self.newest = limit.item(-1)
        self.late += len(time) - int(kept.sum())
        return batch[kept]


@dataclass
class AnyOperator(ABC):
    """Common base of operators and joins: parameters are fields, state is fields with ``init=False``."""

    _late_filters: tuple[LateRowFilter, LateRowFilter] = field(
        default_factory=lambda: (LateRowFilter(), LateRowFilter()), init=False, repr=False, compare=False
    )  # of `process`
    _segment: Segment | None = field(default=None, init=False, repr=False, compare=False)
    _finger: int = field(default=EVERY, init=False, repr=False, compare=False)

    def reset_copy(self) -> Self:
        """Return a copy with the same parameters and initial state."""
        return replace(self)

    def steps(self, *given: RowType) -> Steps | None:
        """Return the functions of one row that the operator consists of, for input of these types.

        By default None: the operator has `process`, which takes batches.
        """
        return None

    def row_type(self, *given: RowType) -> RowType:
        """Return the type of the output for these inputs, with the cells of the first that has any."""
        cells = next((each.cells for each in given if layout(each.kind).cell_column), given[0].cells)
        return RowType(output_type(type(self)), cells)

    @abstractmethod
    def flush(self) -> Any:
        """Return the output that the end of the stream completes."""
        return self._joined(self._segment.flush() if self._segment else [])

    def output_fingertip(self, given: Fingertip) -> Fingertip:
        """Return the fingertip of the output for input of the fingertip `given`, by default the same.

        Operators that require certain cells, a rate or a unit check it here, before a flow runs.

        Raises:
            FingertipError: if the input does not fit.
        """
        self.for_fingertip(given)
        return given

    def for_fingertip(self, given: Fingertip) -> Self:
        """Return the operator with the defaults for this fingertip of its input, which a flow knows.

        Raises:
            FingertipError: if the input does not fit.
        """
        return self

    @property
    def late(self) -> int:
        """Rows dropped because they arrived after newer ones."""
        return sum(each.late for each in self._late_filters) + (self._segment.late if self._segment else 0)

    def __ror__(self, other: Never) -> NoReturn:
        """Raise an error: a source becomes a stream first."""
        name = type(cast("object", other)).__name__
        raise TypeError(f"{name} is not a stream: begin with flow.source(...)")

    def __getstate__(self) -> dict[str, Any]:
        """Return the parameters and Python state; compiled code is made again, with its initial state."""
        return vars(self) | {"_segment": None}

    def _push_rows(self, *batches: Batch) -> Any:
        """Process the rows of one or two inputs that are not late."""
        if fuses(type(self)) and any(batch.time.size for batch in batches) and self._start(batches):
            return self._run_steps(*batches)
        kept = [late.filter(batch) for late, batch in zip(self._late_filters, batches, strict=False)]
        if any(batch.time.size for batch in kept):
            return cast("Any", self).process(*kept)
        return output_type(type(self)).empty()

    def _start(self, batches: tuple[Batch, ...]) -> bool:
        """Create the segment of an operator that consists of steps; return False if it does not."""
        if self._segment is None:
            given = _row_types(batches)
            if (steps := self.steps(*given)) is None:
                return False
            self._segment = Segment(given, [Stage(steps, self.row_type(*given), tuple(range(len(given))))])
        return True

    def _run_steps(self, *batches: Batch) -> Any:
        """Run the steps on at least one row."""
        if not self._start(batches):
            raise _without_process(self)
        if batches[0].time.size:
            self._finger = batches[0].finger
        full = [side for side, batch in enumerate(batches) if batch.time.size]
        return self._joined(cast("Segment", self._segment).pusher(*full)(*(batches[side] for side in full)))

    def _joined(self, outputs: Outputs) -> Any:
        """Return the output of the segment as one batch."""
        if not outputs:
            return output_type(type(self)).empty()
        kind = type(outputs[0][1])
        rows = [batch.packed for _, batch in outputs]
        return kind.unpack(rows[0] if len(rows) == 1 else np.concatenate(rows), self._finger)


@dataclass
class Operator(AnyOperator, Generic[In, Out]):
    """Operator with one input stream and one output stream.

    Subclasses are dataclasses that implement `process`, and `flush` if the end of the stream completes
    output; the operators of slipflow implement `steps` instead. All must be pure: no I/O, no clock, no
    waiting.
    """

    def push(self, batch: In) -> Out:
        """Process the next rows and return the output, which may be empty.

        Late rows are dropped and counted in `late`.
        """
        if fuses(type(self)):
            return cast("Out", self._push_rows(batch))
        kept = self._late_filters[0].filter(batch)
        return self.process(kept) if kept.time.size else cast("Out", output_type(type(self)).empty())

    def process(self, batch: In) -> Out:
        """Process at least one row; time never decreases."""
        return cast("Out", self._run_steps(batch))

    def flush(self) -> Out:
        """Return the output that the end of the stream completes."""
        return cast("Out", super().flush())


@dataclass
class Join(AnyOperator, Generic[Left, Right, Out]):
    """Operator with two input streams and one output stream.

    A replay passes slices of both streams for the same time span. A live run passes rows of one stream and an
    empty batch for the other.
    """

    def push(self, left: Left, right: Right) -> Out:
        """Process the next rows of either stream and return the output, which may be empty."""
        return cast("Out", self._push_rows(left, right))

    def process(self, left: Left, right: Right) -> Out:
        """Process at least one row of either stream; time never decreases within each."""
        return cast("Out", self._run_steps(left, right))

    def flush(self) -> Out:
        """Return the output that the end of both streams completes."""
        return cast("Out", super().flush())


@cache
def fuses(kind: type[AnyOperator]) -> bool:
    """Return whether the steps of an operator are used: no subclass of the one with steps has a `process`."""
    for each in kind.__mro__:
        if "steps" in vars(each):
            return each is not AnyOperator
        if "process" in vars(each) and each not in {Operator, Join}:
            return False
    return False


def _row_types(batches: tuple[Batch, ...]) -> tuple[RowType, ...]:
    """Return the types of the inputs; one without rows yet has the cells of the other."""
    known = [batch.cells for batch in batches if batch.time.size and batch.cells]
    return tuple(
        RowType(type(each), known[0] if known and each.cells and not each.time.size else each.cells)
        for each in batches
    )


def require_process(operator: AnyOperator) -> None:
    """Require that an operator without steps has `process`.

    Raises:
        InputError: if it has not.
    """
    if not fuses(kind := type(operator)) and cast("Any", kind).process in {Operator.process, Join.process}:
        raise _without_process(operator)


def _without_process(operator: AnyOperator) -> InputError:
    takes = "left: Touch, right: Motion" if isinstance(operator, Join) else "batch: Scores"
    return InputError(type(operator).__name__, f"has no process: write def process(self, {takes})")


@cache
def input_types(kind: type[AnyOperator]) -> tuple[type[Batch], ...]:
    """Return the input types that a class declares, as ``class Smooth(Operator[Scores, Scores])``.

    Raises:
        InputError: if it declares none.
    """
    return _declared(kind)[:-1]


@cache
def output_type(kind: type[AnyOperator]) -> type[Batch]:
    """Return the output type that a class declares.

    Raises:
        InputError: if it declares none.
    """
    return _declared(kind)[-1]


def _declared(kind: type[AnyOperator]) -> tuple[type[Batch], ...]:
    for each in kind.__mro__:
        for base in getattr(each, "__orig_bases__", ()):
            found = get_args(base)
            if found and all(isinstance(given, type) and issubclass(given, Batch) for given in found):
                return tuple(found)
    base = "Join[Touch, Motion, Sample]" if issubclass(kind, Join) else "Operator[Scores, Scores]"
    reason = f"declares no batch types of input and output: write class {kind.__name__}({base})"
    raise InputError(kind.__name__, reason)
