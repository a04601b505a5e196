"""Files of ../shared/cases in formats that no other test writes."""

from pathlib import Path

import numpy as np
import pytest

from connectors import Trace
from connectors.files.column_map import ColumnMap
from operators.batch import Touch, concat

CASES = Path(__file__).parents[3].parent / "shared/cases"


def case(path: str) -> Path:
    if not (CASES / path).exists():
        pytest.skip(f"{CASES / path} is missing: the shared material belongs next to the checkout")
    return CASES / path


def test_arrays_with_a_row_per_channel_are_turned() -> None:
    arrays = dict(np.load(case("matlab_transposed/biotac.npz")))
    trace = Trace(arrays, ColumnMap.parse("rate=100,counts=F0Electrodes*"))
    assert trace.part.touch.counts.tolist() == arrays["F0Electrodes"].T.tolist()


def test_a_label_of_all_rows_and_two_fingertips() -> None:
    for label, code in (("slip", 1), ("static", 0)):
        trace = Trace(case(f"label_per_file/{label}.csv"), ColumnMap(labelled=label))
        assert trace.part.labels.tolist() == [code] * 240
    trace = Trace(case("two_fingertips/two.csv"), ColumnMap.parse("counts.0=L1..L3,counts.1=R1..R3"))
    assert trace.fingers(Touch) == (0, 1)
    second = concat(Touch, list(trace.read(Touch, 1)))
    columns = trace.part.columns.offset or (0,) * 6
    assert (second.counts[0] + columns[3:]).tolist() == [32967, 33008, 33018]
