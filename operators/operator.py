"""Base classes of operators and joins.

Invariant of every operator: **cutting the input anywhere changes nothing**. However a stream is cut into
batches, the concatenated output is identical, bit for bit.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cache
from inspect import signature
from typing import Any, Generic, Self, TypeVar, cast, get_type_hints

import numpy as np

from operators.batch import BAROMETERS, Batch
from operators.errors import ParameterError
from operators.fingertip import Fingertip

In = TypeVar("In", bound=Batch, contravariant=True)
Left = TypeVar("Left", bound=Batch, contravariant=True)
Right = TypeVar("Right", bound=Batch, contravariant=True)
Out = TypeVar("Out", bound=Batch, covariant=True)
SomeBatch = TypeVar("SomeBatch", bound=Batch)

_EARLIEST = int(np.iinfo(np.int64).min)
_prepared = set[str]()  # operators with their parameters, whose loops this process has compiled


@dataclass
class LateRowFilter:
    """Filter that drops and counts late rows: rows older than the newest one before them."""

    newest: int = _EARLIEST  # ns
    late: int = 0  # rows

    def filter(self, batch: SomeBatch) -> SomeBatch:
        """Return the rows that are not late; rows with equal stamps keep their order of arrival."""
        time = batch.time
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
class Step(ABC):
    """Common base of operators and joins: parameters are fields, state is fields with ``init=False``."""

    def reset_copy(self) -> Self:
        """Return a copy with the same parameters and initial state."""
        return replace(self)

    def prepare(self) -> None:
        """Do slow set-up, such as loading compiled code, before the first push; runners call this.

        An operator of slipflow compiles its loops: a copy processes a row of zeros, once per process.
        """
        kind, operator = type(self), repr(self)
        if kind.__module__.startswith("operators.") and operator not in _prepared:
            copy: Any = self.reset_copy()
            copy.push(*(each.zeros(cells=self._example_cells) for each in input_types(kind)))
            copy.flush()
            _prepared.add(operator)

    def output_fingertip(self, given: Fingertip) -> Fingertip:
        """Return the fingertip of the output for input of the fingertip `given`, by default the same.

        Operators that require certain cells, a rate or a unit check it here, before a flow runs.

        Raises:
            FingertipError: if the input does not fit.
        """
        return given

    @property
    def _example_cells(self) -> int:
        """Number of cells of the rows that `prepare` processes."""
        return BAROMETERS

    @property
    @abstractmethod
    def late(self) -> int:
        """Rows dropped because they arrived after newer ones."""


@dataclass
class Operator(Step, Generic[In, Out]):
    """Operator with one input stream and one output stream.

    Subclasses are dataclasses that implement `process`, and `flush` if the end of the stream completes
    output. Both must be pure: no I/O, no clock, no waiting.
    """

    _late_filter: LateRowFilter = field(default_factory=LateRowFilter, init=False, repr=False)

    def push(self, batch: In) -> Out:
        """Process the next rows and return the output, which may be empty.

        Late rows are dropped and counted in `late`.
        """
        if batch.time.size and (kept := self._late_filter.filter(batch)).time.size:  # faster than `len`
            return self.process(kept)
        return cast("Out", output_type(type(self)).empty())

    @abstractmethod
    def process(self, batch: In) -> Out:
        """Process at least one row; time never decreases."""

    def flush(self) -> Out:
        """Return the output that the end of the stream completes."""
        return cast("Out", output_type(type(self)).empty())

    @property
    def late(self) -> int:
        """Rows dropped because they arrived after newer ones."""
        return self._late_filter.late


@dataclass
class Join(Step, Generic[Left, Right, Out]):
    """Operator with two input streams and one output stream.

    A replay passes slices of both streams for the same time span. A live run passes rows of one stream and an
    empty batch for the other.
    """

    _late_left: LateRowFilter = field(default_factory=LateRowFilter, init=False, repr=False)
    _late_right: LateRowFilter = field(default_factory=LateRowFilter, init=False, repr=False)

    def push(self, left: Left, right: Right) -> Out:
        """Process the next rows of either stream and return the output, which may be empty."""
        if left.time.size:
            left = self._late_left.filter(left)
        if right.time.size:
            right = self._late_right.filter(right)
        if left.time.size or right.time.size:
            return self.process(left, right)
        return cast("Out", output_type(type(self)).empty())

    @abstractmethod
    def process(self, left: Left, right: Right) -> Out:
        """Process at least one row of either stream; time never decreases within each."""

    def flush(self) -> Out:
        """Return the output that the end of both streams completes."""
        return cast("Out", output_type(type(self)).empty())

    @property
    def late(self) -> int:
        """Rows dropped because they arrived after newer ones."""
        return self._late_left.late + self._late_right.late


@cache
def input_types(kind: type[Step]) -> tuple[type[Batch], ...]:
    """Return the input types that the annotations of `process` declare.

    Raises:
        ParameterError: if an annotation is missing.
    """
    return _declared(kind)[:-1]


@cache
def output_type(kind: type[Step]) -> type[Batch]:
    """Return the output type that the annotations of `process` declare.

    Raises:
        ParameterError: if an annotation is missing.
    """
    return _declared(kind)[-1]


def _declared(kind: type[Step]) -> tuple[type[Batch], ...]:
    process: Any = cast("Any", kind).process
    hints = get_type_hints(process)
    found = signature(process)
    names = [*list(found.parameters)[1:], "return"]
    inputs = "two batches" if issubclass(kind, Join) else "one batch"
    if len(names) != (3 if issubclass(kind, Join) else 2):
        raise ParameterError(kind.__name__, "the signature of process", str(found), f"self and {inputs}")
    for name in names:
        if not (isinstance(hints.get(name), type) and issubclass(hints[name], Batch)):
            must_be = "a batch type, as in def process(self, batch: Zeroed) -> Scores"
            raise ParameterError(
                kind.__name__, f"the annotation of process, {name},", hints.get(name), must_be
            )
    return tuple(hints[name] for name in names)
