import pickle
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from operators import Batch, BatchError, Labelled, Motion, Scores, Slips, Touch, Windows, Zeroed, concat, ms
from operators.batch import Counts, Reals, columns
from operators.column import column
from tests.storage.made import new_batch, same

KINDS = [Touch, Zeroed, Labelled, Motion, Windows, Scores, Slips]


def _columns(kind: type[Batch], rows: int) -> list[Any]:
    shapes = [(rows, *(max(size, 1) for size in column.shape)) for column in columns(kind).values()]
    return [np.zeros(shape, c.dtype) for shape, c in zip(shapes, columns(kind).values(), strict=True)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("wrong", ["type", "shape", "length", "no array"])
def test_a_column_of_another_type_shape_or_length_is_named(kind: type[Batch], wrong: str) -> None:
    for place, name in enumerate(columns(kind)):
        values = _columns(kind, 3)
        if wrong == "type":
            values[place] = values[place].astype(np.complex64)
        elif wrong == "no array":  # as a column of a table of another library
            column = values[place]
            values[place] = SimpleNamespace(dtype=column.dtype, shape=column.shape, size=column.size)
        else:
            values[place] = values[place][..., None] if wrong == "shape" else values[place][:2]
        with pytest.raises(BatchError, match=rf"^{kind.__name__}\.({name if place else '.*'}): "):
            kind(*values).check()


def test_batches_of_several_fingertips_cannot_become_one() -> None:
    values = _columns(Scores, 1)
    with pytest.raises(BatchError, match="several fingertips"):
        concat(Scores, [Scores(*values, finger=0), Scores(*values, finger=1)])


def test_a_batch_type_whose_field_is_no_column_is_refused_when_it_is_defined() -> None:
    expected = r"^Force\.normal: is not a column: write normal: Reals = column\(np.float64, unit=\.\.\.\)$"
    with pytest.raises(BatchError, match=expected):

        class Force(Batch):
            normal: Reals  # plain, as in a dataclass


@pytest.mark.parametrize(
    "name", ["mean", "size", "T", "packed", "finger", "time", "check", "later", "zeros", "cells"]
)
def test_a_column_named_as_what_batches_or_numpy_have_is_refused(name: str) -> None:
    expected = rf"^Force\.{name}: is a name that batches or rows of numpy use: choose another one$"
    with pytest.raises(BatchError, match=expected):
        type("Force", (Batch,), {"__annotations__": {name: Reals}, name: column(np.float64)})


def test_a_batch_type_that_is_decorated_as_a_dataclass_keeps_its_columns() -> None:
    class Force(Batch):
        normal: Reals = column(np.float64, unit="N")

    dataclass(Force)  # as a user may write, against the type checker

    class Grasp(Force):
        raw: Counts = column(np.int16)

    assert [list(columns(kind)) for kind in (Force, Grasp)] == [["time", "normal"], ["time", "normal", "raw"]]
    assert Grasp.zeros(2).check()[1:].raw.tolist() == [0]


def _subtypes(kind: type[Batch]) -> list[type[Batch]]:
    return [each for sub in kind.__subclasses__() for each in (sub, *_subtypes(sub))]


ALL = [Batch, *(kind for kind in _subtypes(Batch) if kind.__module__ == Batch.__module__)]


@pytest.mark.parametrize("cells", [1, 6, 16])
@pytest.mark.parametrize("kind", ALL)
def test_packed_rows_keep_all_columns_bit_for_bit(kind: type[Batch], cells: int) -> None:
    batch = new_batch(kind, 5, cells=cells)
    packed = kind.unpack(batch.packed, batch.finger)
    same(packed.check(), batch)
    same(pickle.loads(pickle.dumps(packed)), batch)  # noqa: S301 our own bytes
    rows = slice(1, 4)
    same(packed[rows], batch[rows])
    same(packed[np.array([3, 1])], batch[np.array([3, 1])])
    same(packed[batch.time % (20 * ms) == 0], batch[batch.time % (20 * ms) == 0])
    same(concat(kind, [packed[:2], packed[:0], packed[2:]]), batch)
    same(concat(kind, [packed[:2], batch[2:]]), batch)  # one of each form


def test_a_source_may_yield_no_rows_and_the_same_value_for_all_cells() -> None:
    nothing = Touch.rows([], [], [], [])
    assert (len(nothing.check()), nothing.cells) == (0, 6)
    assert Touch.rows([], np.zeros((0, 9)), 0, True).cells == 9
    assert Touch.rows([1, 2], 500, np.zeros((2, 9)), True).check().counts.tolist() == [[500] * 9] * 2


@pytest.mark.parametrize("count", [70_000, 1.5])
def test_counts_that_16_bits_cannot_hold_are_refused_by_packed_rows(count: float) -> None:
    counts, zero = np.full((1, 6), count), np.zeros((1, 6), np.int16)
    for make in (
        lambda: Touch.rows([1], counts, 0, True),
        lambda: Touch(np.array([1]), cast("Counts", counts), zero, zero == 0).packed,
    ):
        with pytest.raises(BatchError, match=r"^Touch\.counts: has values that int16 cannot hold$"):
            make()


def test_columns_and_slices_of_packed_rows_are_views() -> None:
    batch = new_batch(Labelled)
    packed = Labelled.unpack(batch.packed)
    for name in columns(Labelled):
        for rows in (packed, packed[1:3]):
            assert np.shares_memory(getattr(rows, name), batch.packed)
        assert getattr(packed, name) is getattr(packed, name)  # made once
    with pytest.raises(AttributeError):
        packed.probability  # type: ignore[attr-defined]  # noqa: B018


def test_packed_rows_of_another_type_are_refused() -> None:
    with pytest.raises(BatchError, match=r"^Motion\.device_time: is missing in packed rows"):
        Motion.unpack(Scores.zeros(2).packed).check()
