from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from operators import Batch, BatchError, Labelled, Motion, Scores, Slips, Touch, Windows, Zeroed, concat
from operators.batch import columns

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
