"""Files of ../shared/cases in formats that no other test writes: a value, or the error of its README."""

from pathlib import Path

import numpy as np
import pytest

from connectors import Trace
from connectors.files.column_map import ColumnMap
from operators.batch import Touch, concat
from operators.errors import InputError

CASES = Path(__file__).parents[3].parent / "shared/cases"
SCRIPT = r"read it in Python \(.*\) and pass a DataFrame to import_frame"


def case(path: str) -> Path:
    if not (CASES / path).exists():
        pytest.skip(f"{CASES / path} is missing: the shared material belongs next to the checkout")
    return CASES / path


@pytest.mark.parametrize(
    ("path", "start", "unit", "lowest"),
    [
        ("date_with_comma_fraction/log.csv", 1742999346, "count", 438),
        ("date_with_comma_fraction/quoted.csv", 1742999346, "count", 438),
        ("excel_and_preamble/units_row.csv", 0, "kPa", 101.2),
    ],
)
def test_a_case_gives_the_right_value(path: str, start: int, unit: str, lowest: float) -> None:
    trace = Trace(case(path))
    found = trace.part.touch
    assert (len(found), trace.part.columns.unit) == (240, unit)
    assert np.ptp(found.time) / 1e9 == pytest.approx(2.4, abs=0.02)
    assert trace.part.columns.rate == pytest.approx(100, abs=0.1)
    assert int(found.time[0]) // 10**9 == start
    assert trace.part.extent[0] == pytest.approx(lowest, rel=0.01)


@pytest.mark.parametrize(
    ("path", "complaint"),
    [
        (
            "date_with_comma_fraction/bad.csv",
            "line 2, column time: is '2025-13-45 x', must be a date and time",
        ),
        ("epoch_lost/epoch_float32.parquet", "column timestamp has only 1 value in 240 rows"),
        ("other_formats/a.mat", f"is a MATLAB file: {SCRIPT}"),
        ("other_formats/a.h5", f"is an HDF5 file: {SCRIPT}"),
        ("other_formats/a.npy", f"is an array of numpy: {SCRIPT}"),
        ("other_formats/a.xlsx", "is an Excel file: save it as CSV"),
        ("matlab_transposed/biotac.npz", f"is an NPZ file: {SCRIPT}"),
    ],
)
def test_a_case_is_refused_with_the_remedy(path: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        assert Trace(case(path)).part.touch


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
