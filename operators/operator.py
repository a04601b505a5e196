"""What an operator is: a pure, restartable step from batches to batches.

The law that every operator keeps: **cutting the input anywhere changes nothing**. However a stream is cut
into batches, the concatenated output is the same, bit for bit.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cache
from inspect import signature
from typing import Any, Generic, Self, TypeVar, cast, get_type_hints

import numpy as np

from operators.batch import Batch
from operators.errors import ParameterError

In = TypeVar("In", bound=Batch, contravariant=True)
Left = TypeVar("Left", bound=Batch, contravariant=True)
Right = TypeVar("Right", bound=Batch, contravariant=True)
Out = TypeVar("Out", bound=Batch, covariant=True)
SomeBatch = TypeVar("SomeBatch", bound=Batch)

_BEGINNING = int(np.iinfo(np.int64).min)


@dataclass
class LateRowFilter:
    """Keeps one input in order: a row older than the newest one seen is late; it is dropped and counted."""

    newest: int = _BEGINNING  # ns
    late: int = 0  # rows

    def filter(self, batch: SomeBatch) -> SomeBatch:
        """The rows that are not late; equal stamps are kept, in their order of arrival."""
        time, newest = batch.time, self.newest
        if len(time) == 1:
            first = time.item(0)
            if first < newest:
                self.late += 1
                return batch[:0]
            self.newest = first
            return batch
        if time.item(0) >= newest and bool((time[1:] >= time[:-1]).all()):
            self.newest = time.item(-1)
            return batch
        limit = np.maximum.accumulate(np.maximum(time, newest))  # (n,)
        kept = time >= limit  # (n,)
        self.newest = limit.item(-1)
        self.late += len(time) - int(kept.sum())
        return batch[kept]


@dataclass
class Step(ABC):
    """What operators and joins have in common: parameters are fields, state is fields with ``init=False``."""

    def reset_copy(self) -> Self:
        """The same parameters, the state forgotten."""
        return replace(self)

    @property
    @abstractmethod
    def late(self) -> int:
        """Rows dropped because they came after newer ones of the same stream."""


@dataclass
class Operator(Step, Generic[In, Out]):
    """One stream in, one stream out.

    Subclasses are dataclasses that write `process`, and `flush` where the end of the stream completes
    something. Both must be pure: no I/O, no clock, no waiting. State is pickled whole to snapshot it.
    """

    _order: LateRowFilter = field(default_factory=LateRowFilter, init=False, repr=False)

    def push(self, batch: In) -> Out:
        """Take the next rows; give what they complete, which may be nothing.

        An empty batch gives an empty batch. Late rows are dropped and counted in `late`.
        """
        if batch.time.size and (kept := self._order.filter(batch)).time.size:  # `len` costs a call
            return self.process(kept)
        return cast("Out", output_type(type(self)).empty())

    @abstractmethod
    def process(self, batch: In) -> Out:
        """Take at least one row; time never decreases."""

    def flush(self) -> Out:
        """Give what the end of the stream completes."""
        return cast("Out", output_type(type(self)).empty())

    @property
    def late(self) -> int:
        """Rows dropped because they came after newer ones."""
        return self._order.late


@dataclass
class Join(Step, Generic[Left, Right, Out]):
    """Two streams in, one stream out.

    Rows given in one call arrived together; a replay gives both streams a slice of the same time span,
    a live run gives one of them rows and the other an empty batch.
    """

    _order_left: LateRowFilter = field(default_factory=LateRowFilter, init=False, repr=False)
    _order_right: LateRowFilter = field(default_factory=LateRowFilter, init=False, repr=False)

    def push(self, left: Left, right: Right) -> Out:
        """Take the next rows of either stream; give what they complete, which may be nothing."""
        if left.time.size:
            left = self._order_left.filter(left)
        if right.time.size:
            right = self._order_right.filter(right)
        if left.time.size or right.time.size:
            return self.process(left, right)
        return cast("Out", output_type(type(self)).empty())

    @abstractmethod
    def process(self, left: Left, right: Right) -> Out:
        """Take at least one row of either; time never decreases within each."""

    def flush(self) -> Out:
        """Give what the end of both streams completes."""
        return cast("Out", output_type(type(self)).empty())

    @property
    def late(self) -> int:
        """Rows dropped because they came after newer ones."""
        return self._order_left.late + self._order_right.late


@cache
def input_types(kind: type[Step]) -> tuple[type[Batch], ...]:
    """The batch types that a step takes, as its `process` declares them.

    Raises:
        ParameterError: if it does not declare them.
    """
    return _declared(kind)[:-1]


@cache
def output_type(kind: type[Step]) -> type[Batch]:
    """The batch type that a step gives, as its `process` declares it.

    Raises:
        ParameterError: if it does not declare it.
    """
    return _declared(kind)[-1]


def _declared(kind: type[Step]) -> tuple[type[Batch], ...]:
    process: Any = cast("Any", kind).process
    hints = get_type_hints(process)
    names = [*list(signature(process).parameters)[1:], "return"]
    for name in names:
        if not (isinstance(hints.get(name), type) and issubclass(hints[name], Batch)):
            like = "a batch type, as in def process(self, batch: Zeroed) -> Scores"
            raise ParameterError(kind.__name__, f"the annotation of process, {name},", hints.get(name), like)
    return tuple(hints[name] for name in names)
