"""The files of ../shared/cases: each gives the right value, or the error that its README states."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.trace import interpreted
from operators import Zero, Zeroed
from operators.batch import Touch, concat
from operators.errors import InputError

CASES = Path(__file__).parents[3].parent / "shared/cases"
SCRIPT = r"read it in Python \(.*\) and pass a DataFrame to import_frame"


def case(path: str) -> Path:
    if not (CASES / path).exists():
        pytest.skip(f"{CASES / path} is missing: the shared material belongs next to the checkout")
    return CASES / path


@pytest.mark.parametrize(
    ("path", "columns", "expected"),
    [
        ("date_with_comma_fraction/log.csv", "", (240, 2.4, 100.0, 1742999346, "count", 438)),
        ("date_with_comma_fraction/quoted.csv", "", (240, 2.4, 100.0, 1742999346, "count", 438)),
        ("excel_and_preamble/sep.csv", "", (240, 2.4, 100.0, 0, "count", 438)),
        ("excel_and_preamble/trailing.csv", "", (240, 2.4, 100.0, 0, "count", 438)),
        ("excel_and_preamble/micro.csv", "", (240, 2.4, 100.0, 0, "count", 438)),
        ("excel_and_preamble/preamble.csv", "", (240, 2.4, 100.0, 0, "count", 438)),
        ("excel_and_preamble/cr.csv", "", (240, 2.4, 100.0, 0, "count", 438)),
        ("excel_and_preamble/units_row.csv", "", (240, 2.4, 100.0, 0, "kPa", 101.2)),
        ("micros_rollover/roll.csv", "", (240, 2.4, 100.0, 4293, "count", 438)),
        ("millipascal/mpa.csv", "", (240, 2.4, 100.0, 0, "mPa", 242)),
        ("other_dates/epoch_ms.csv", "", (60, 0.6, 100.2, 1742999346, "count", 498)),
        ("other_dates/epoch_ns.csv", "", (60, 0.6, 100.2, 1742999346, "count", 498)),
        ("other_dates/german.csv", "", (60, 0.6, 100.0, 1742999346, "count", 498)),
        ("other_dates/two_columns.csv", "", (60, 0.6, 100.0, 1742999346, "count", 498)),
        ("other_formats/a.PARQUET", "", (20, 0.2, 100.0, 0, "count", 500)),
        ("other_formats/parquet_without_ending", "", (20, 0.2, 100.0, 0, "count", 500)),
        ("quantised_ms/fast.csv", "", (1000, 0.6, 1673.4, 10, "count", 498)),
        ("epoch_lost/epoch6.csv", "time=,rate=100", (240, 2.4, 100.0, 0, "count", 438)),
        ("one_bit_error/bits_quiet.csv.gz", "", (3000, 30.0, 100.0, 0, "count", None)),
    ],
)
def test_a_case_gives_the_right_value(path: str, columns: str, expected: tuple[Any, ...]) -> None:
    rows, seconds, rate, start, unit, lowest = expected
    trace = Trace(case(path), ColumnMap.parse(columns))
    found = trace.touch
    assert (len(found), trace.columns.unit) == (rows, unit)
    assert np.ptp(found.time) / 1e9 == pytest.approx(seconds, abs=0.02)
    assert trace.columns.rate == pytest.approx(rate, abs=0.1)
    assert int(found.time[0]) // 10**9 == start
    assert lowest is None or trace.extent[0] == pytest.approx(lowest, rel=0.01)


@pytest.mark.parametrize(
    ("path", "complaint"),
    [
        (
            "date_with_comma_fraction/bad.csv",
            "line 2, column time: is '2025-13-45 x', must be a date and time",
        ),
        (
            "epoch_lost/epoch6.csv",
            "column t has only 1 value in 240 rows: it tells no rate; state time=,rate=",
        ),
        ("epoch_lost/epoch10.csv", "column t has only 4 values in 240 rows, 1 s apart: it tells no rate"),
        ("epoch_lost/epoch_float32.parquet", "column timestamp has only 1 value in 240 rows"),
        ("thousands_english/pa.csv", r"both point and comma \(column t: 0.00 and column p0_Pa: 101,2"),
        ("other_formats/a.mat", f"is a MATLAB file: {SCRIPT}"),
        ("other_formats/a.bag", f"is a ROS 1 bag: {SCRIPT}"),
        ("other_formats/a.h5", f"is an HDF5 file: {SCRIPT}"),
        ("other_formats/a.npy", f"is an array of numpy: {SCRIPT}"),
        ("other_formats/a.xlsx", "is an Excel file: save it as CSV"),
        ("matlab_transposed/biotac.npz", f"is an NPZ file: {SCRIPT}"),
        (
            "logger_restarted/restarted.csv",
            r"line 102, column t: .*--split makes 3 sessions \(100, 80, 60 rows\)",
        ),
        ("two_fingertips/two.csv", "try --map time=time_ms,counts.0=L1..L3,counts.1=R1..R3"),
    ],
)
def test_a_case_is_refused_with_the_remedy(path: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        assert Trace(case(path)).touch


def test_arrays_with_a_row_per_channel_are_turned() -> None:
    arrays = dict(np.load(case("matlab_transposed/biotac.npz")))
    trace = Trace(arrays, ColumnMap.parse("rate=100,counts=F0Electrodes*"))
    assert trace.touch.counts.tolist() == arrays["F0Electrodes"].T.tolist()


def test_a_label_of_all_rows_a_restarted_logger_and_two_fingertips() -> None:
    for label, code in (("slip", 1), ("static", 0)):
        trace = Trace(case(f"label_per_file/{label}.csv"), ColumnMap(labelled=label))
        assert trace.labels.tolist() == [code] * 240
    parts = interpreted(case("logger_restarted/restarted.csv"), split=True)
    assert [len(part.touch) for part in parts] == [100, 80, 60]
    trace = Trace(case("two_fingertips/two.csv"), ColumnMap.parse("counts.0=L1..L3,counts.1=R1..R3"))
    assert trace.fingers(Touch) == (0, 1)
    second = concat(Touch, list(trace.read(Touch, 1)))
    columns = trace.columns.offset or (0,) * 6
    assert (second.counts[0] + columns[3:]).tolist() == [32967, 33008, 33018]


def test_one_sentinel_does_not_change_the_meaning_of_a_file() -> None:
    trace = Trace(case("sentinel_minus_999/s.csv"))
    assert trace.kind is Touch
    assert trace.warnings[0].startswith("line 52, column p2 is -999, far from all others: taken as missing")
    assert [each.tolist() for each in np.nonzero(~trace.touch.valid)] == [[50], [2]]
    zero = Zero()
    zeroed = concat(Zeroed, [zero.push(trace.touch), zero.flush()])
    assert abs(zeroed.counts[:50]).max() < 10
