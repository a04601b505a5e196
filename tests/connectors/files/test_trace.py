import hashlib
from collections.abc import Callable
from decimal import ROUND_HALF_EVEN, Decimal
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.text_table import IN_PYTHON
from operators.batch import EVERY, Motion, Touch, Zeroed, concat
from operators.errors import InputError
from tests.connectors.files.conftest import Write

HEADER = "t,s1,s2,s3,s4,s5,s6"


def test_a_trace_is_read_as_it_is_written(write: Write) -> None:
    trace = Trace(
        write(
            f"{HEADER},label,energy",
            "0.5,1,2,3,4,5,-6,0,1.5",
            "0.51,1,2,3,4,5,6.0,1,",
            "0.51,0,0,0,0,0,0,-1,x",
        )
    )
    touch = trace.part.touch.check()
    assert touch.time.tolist() == [500_000_000, 510_000_000, 510_000_000]
    assert touch.counts.tolist() == [[1, 2, 3, 4, 5, -6], [1, 2, 3, 4, 5, 6], [0] * 6]
    assert touch.valid.all()
    assert not touch.temperature.any()
    assert trace.part.labels.tolist() == [0, 1, -1]
    assert trace.part.labels.dtype == np.int8
    assert trace.describe() == {
        "trace": "trace.csv",
        "sha256": hashlib.sha256(Path(trace.name).read_bytes()).hexdigest(),
        "rows": 3,
        "zeroed": True,
        "columns": {"time": ["t"], "counts": ["s1", "s2", "s3", "s4", "s5", "s6"], "label": ["label"]},
        "units": {"time": "s", "counts": "count"},
    }


@pytest.mark.parametrize(
    ("start", "zeroed", "kind"),
    [
        ((0, 0), None, Zeroed),
        ((500, 480), None, Touch),
        ((-500, -480), None, Touch),
        ((500, 480), True, Zeroed),
        ((0, 0), False, Touch),
    ],
)
@pytest.mark.parametrize("faulty", [False, True])
def test_the_range_of_the_cells_and_not_one_reading_decides_whether_they_are_zeroed(
    *, write: Write, start: tuple[int, int], zeroed: bool | None, kind: type[Touch], faulty: bool
) -> None:
    rows = [[start[0] + k % 9 - 4, start[1] - k % 50] for k in range(100)]
    rows[70][1] = -999 if faulty else rows[70][1]
    path = write("t,p0,p1", *(f"{k / 100},{a},{b}" for k, (a, b) in enumerate(rows)))
    trace = Trace(path, ColumnMap(zeroed=zeroed))
    assert type(trace.part.touch) is kind
    assert trace.fingers(Touch) == (0,)
    assert trace.fingers(Zeroed) == ((0,) if kind is Zeroed else ())
    assert trace.fingers(Motion) == ()
    assert int((~trace.part.touch.valid).sum()) == faulty
    doubt = "line 72, column p1 is -999, far from all others: taken as missing"
    assert any(doubt in each for each in trace.part.warnings) == faulty


@given(st.decimals(-9_000_000_000, 9_000_000_000, allow_nan=False, places=12))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_seconds_become_the_nearest_nanosecond(write: Write, time: Decimal) -> None:
    nearest = int(time.scaleb(9).to_integral_value(ROUND_HALF_EVEN))
    found = Trace(write(HEADER, f"{time:f},1,2,3,4,5,6")).part.touch.time.item()
    assert found == nearest or abs(time.scaleb(9) - found) == Decimal("0.5")


@given(st.integers(1, 30), st.integers(1, 12))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_the_batches_of_any_size_are_the_whole_trace(write: Write, length: int, rows: int) -> None:
    trace = Trace(write(HEADER, *(f"{i / 100},{i},2,3,4,5,6" for i in range(length))))
    batches = list(trace.read(Touch, 0, rows))
    assert {len(batch) for batch in batches[:-1]} <= {rows}
    assert len(batches[-1]) <= rows
    assert concat(Touch, batches).counts.tolist() == trace.part.touch.counts.tolist()


WHOLE = "must be a whole number (or state a unit, as units.counts=kPa, or a resolution)"
LABEL = "neither slip nor static by usual words; state labels.slip=... (others: static)"
UNKNOWN = (
    "neither slip nor static by the map; state labels.unknown=west; try --map time=t,counts=s1,label=state,"
    "labels.slip=north,labels.static=none,labels.unknown=west"
)
MAP = "try --map time=t,counts=s1..s6,label=label,labels.slip="
MORE_FIELDS = "has more fields than line 1 has names; a comma in a value needs quotes"
ORDER = "in order: sort the rows by time, or delete this one"
NO_TIME = "no column is recognised as time; state time=..., or rate=... if it has none"
COLUMNS = "state counts=...; (2) " + NO_TIME + "; try --map time=column1,counts=column2,column3"
T_S1 = "the columns are t s1"
TWICE = "column s1 cannot be used: it occurs twice"
NO_ROWS = "has no rows of numbers below a line that names the columns"
CONVERT = f"decompress it, save it as CSV in UTF-8, or {IN_PYTHON}"
NUMBER = "must be a number, without signs of thousands, or empty"


@pytest.mark.parametrize(
    ("row", "complaint"),
    [
        ("1,1,x,3,4,5,6,0", f"line 3, column s2: is 'x', {NUMBER}"),
        ("1,1,2.5,3,4,5,6,0", f"line 3, column s2: is '2.5', {WHOLE}"),
        ("1,1,2,3,4,5,6,maybe", f"line 3, column label: has 'maybe', {LABEL}; {MAP}WORD"),
        (",1,2,3,4,5,6,0", "line 3, column t: is '', must be a time in s"),
        ("0.4,1,2,3,4,5,6,0", f"line 3, column t: is '0.4', must be {ORDER}"),
        ("1,1,2,3,4,5,6,0,9", f"line 3: {MORE_FIELDS}"),
        ("1,1,2,3,4,5,6,0,,9", f"line 3: {MORE_FIELDS}"),
    ],
)
def test_an_invalid_value_is_named_by_line_and_column(write: Write, row: str, complaint: str) -> None:
    path = write(f"{HEADER},label", "0.5,1,2,3,4,5,6,0", row, "2,1,2,3,4,5,6,0")
    with pytest.raises(InputError) as caught:
        _ = Trace(path).part.touch
    assert str(caught.value) == f"{path}, {complaint}"


@pytest.mark.parametrize(
    ("text", "columns", "complaint"),
    [
        ("t,s1|0,1||1,one", "", f", line 4, column s1: is 'one', {NUMBER}"),
        ("time_ns,s1|1.5,1", "", ", line 2, column time_ns: is '1.5', must be a whole number of ns"),
        (
            "time_ns,s1|9999999999999999999,1",
            "",
            ", line 2, column time_ns: is '9999999999999999999', must be a whole number of ns",
        ),
        (
            't,s1,note|0,1,ok|1,1,"one|2,1,x|3,1,two"|4,1,ok',
            "",
            ", line 3: has a quoted field that spans lines: close its quotation mark",
        ),
        ("s1,s2,s3|1,1,1", "", f": {NO_TIME}; try --map rate=ROWS_PER_SECOND,counts=s1..s3"),
        ("0,1,2|2,1,1|3,1,1", "", f": has 2 problems: (1) column1..column3 may be the cells; {COLUMNS}"),
        ("t,s1, s1|1,1,1", "", f": {TWICE}; try --map time=t,counts=NAME,NAME"),
        ("t,s1,s2,s3, s1|1,1,2,3,1", "", f": {TWICE}; try --map time=t,counts=NAME,NAME"),
        (
            "t,s1,s1|1,1,1",
            "counts=s1",
            ": column s1 cannot be used: it occurs twice; try --map time=t,counts=NAME,NAME",
        ),
        (
            "t,s1|1,1",
            "time=stamp",
            f": there is no column stamp; {T_S1}; try --map rate=ROWS_PER_SECOND,counts=s1",
        ),
        ("t,s1|1,1", "label=truth", f": there is no column truth; {T_S1}; try --map time=t,counts=s1"),
        ("t,s1,s2|0,1,|1,1,", "", ": column s2 has no readings"),
        ("t,s1,s2|0,1,7|1,1,7", "missing=7", ": column s2 has no readings"),
        (
            "t,s1,state|0,1,north|1,1,west",
            "label=state,labels.slip=north,labels.static=none",
            f", line 3, column state: has 'west', {UNKNOWN}",
        ),
        ("", "", ": is empty: its first line must name the columns"),
        ("sep=;", "", f": {NO_ROWS}"),
        ("t,s1", "", f": {NO_ROWS}"),
        ("t,s1|\0\0,1", "", f": is no text, it has bytes of zero: {CONVERT}"),
        ("t,s1,s2|1,2,3|2,3", "", ": the last line has fewer fields than line 2: it is cut off, delete it"),
        (
            "|".join(f"{name},{'1,' * 50}1" for name in ("time", "p0", "p1")),
            "",
            ": has a row per channel (p0, p1, time): transpose it to a row per time",
        ),
    ],
)
def test_a_file_is_refused_with_the_remedy(write: Write, text: str, columns: str, complaint: str) -> None:
    path = write(*text.split("|")) if text else write(end="")
    with pytest.raises(InputError) as caught:
        _ = Trace(path, ColumnMap.parse(columns)).part.touch
    assert str(caught.value) == f"{path}{complaint}"


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent.csv: cannot be read: No such file or directory$"):
        _ = Trace(tmp_path / "absent.csv").part.touch


def test_a_missing_reading_is_an_invalid_cell_and_a_warning(write: Write) -> None:
    trace = Trace(write(HEADER, "0,1,2,3,4,5,6", "1,1,,3,4,nan,6", "2,7,8,9,10,11,12"))
    assert trace.part.touch.valid.tolist() == [[True] * 6, [True, False, True, True, False, True], [True] * 6]
    assert trace.part.touch.counts[1].tolist() == [1, 0, 3, 4, 0, 6]
    assert trace.part.warnings[1] == "missing readings: 2, in 1 of 3 rows"


def test_a_missing_stream_is_refused(write: Write) -> None:
    trace = Trace(write(HEADER, "0,1,2,3,4,5,6"))
    with pytest.raises(InputError, match=r"has no Motion stream of finger 0$"):
        trace.read(Motion, 0)
    with pytest.raises(InputError, match=r"has no Touch stream of finger 1$"):
        trace.read(Touch, 1)


def test_a_speed_becomes_a_motion_along_x(write: Write) -> None:
    path = write(
        f"{HEADER},speed", "0,1,2,3,4,5,6,12.5", "1,1,2,3,4,5,6,", '2,1,2,3,4,5,6,""', "3,1,2,3,4,5,6,-4"
    )
    trace = Trace(path, ColumnMap(units={"speed": "mm/s"}))
    assert trace.fingers(Motion) == (EVERY,)
    motion = concat(Motion, list(trace.read(Motion, EVERY, 1))).check()
    assert motion.time.tolist() == motion.device_time.tolist() == [0, 3_000_000_000]
    assert motion.velocity.tolist() == [[0.0125, 0, 0, 0, 0, 0], [-0.004, 0, 0, 0, 0, 0]]
    assert np.isnan(motion.pose).all()
    assert len(trace.part.touch) == 4
    path = write(f"{HEADER},v", f"[s],{'[count],' * 6}[mm/s]", "0,1,2,3,4,5,6,2", "1,1,2,3,4,5,6,4")
    assert Trace(path).part.motion.velocity[:, 0].tolist() == [0.002, 0.004]  # by a row of units


def test_a_velocity_has_three_or_six_columns_and_precedes_a_speed(write: Write) -> None:
    linear = Trace(write(f"{HEADER},VX,vy,vz,speed", "0,1,2,3,4,5,6,1,2,3,9"))
    assert linear.part.motion.velocity.tolist() == [[1, 2, 3, 0, 0, 0]]
    assert "speed" not in linear.part.columns.columns
    columns = ColumnMap.parse("velocity=a1..a6,units.velocity=cm/s")
    whole = Trace(write(f"{HEADER},a1,a2,a3,a4,a5,a6", "0,1,2,3,4,5,6,1,2,3,4,5,6"), columns)
    assert whole.part.motion.velocity.tolist() == [[0.01, 0.02, 0.03, 4, 5, 6]]  # rad/s as it is


@pytest.mark.parametrize(
    ("labels", "values", "expected"),
    [
        ("", ["0", "1", "-1", "", "Slip", "static", "TRUE", "1.0"], [0, 1, -1, -1, 1, 0, 1, 1]),
        ("", ["Rutschen", "rutscht", "Haften", "haftet", "unbekannt"], [1, 1, 0, 0, -1]),
        ("", ["ja", "nein", "Yes", "no", "unlabeled"], [1, 0, 1, 0, -1]),
        ("labels.static=stuck,1", ["stuck", "slip", "1", "?"], [0, 1, 0, -1]),
        ("labels.slip=1,2", ["0", "1", "2", "7", "", "2.0", "x", "nan"], [0, 1, 1, 0, -1, 1, 0, -1]),
        ("labels.slip=north,labels.static=none,labels.unknown=?", ["North", "none", "?", ""], [1, 0, -1, -1]),
    ],
)
def test_labels_may_have_other_values(
    write: Write, labels: str, values: list[str], expected: list[int]
) -> None:
    path = write(f"{HEADER},state", *(f"{k},1,2,3,4,5,6,{value}" for k, value in enumerate(values)))
    assert Trace(path, ColumnMap.parse(f"label=state,{labels}")).part.labels.tolist() == expected


@pytest.mark.parametrize(
    ("values", "slip"),
    [
        (("stick", "slip", "incipient slip"), "slip"),
        (("no contact", "Sliding", "slip"), "Sliding,slip"),
        (("0", "1", "2"), "WORD"),  # 2 may be slip, and 1 touch
        (("no_slip", "gross slip"), "WORD"),
        (("still", "moving"), "WORD"),
    ],
)
def test_a_suggestion_for_labels_does_not_guess_which_word_is_slip(
    write: Write, values: tuple[str, ...], slip: str
) -> None:
    path = write(f"{HEADER},label", *(f"{k},1,2,3,4,5,6,{value}" for k, value in enumerate(values)))
    with pytest.raises(InputError, match=rf"label=label,labels.slip={slip}'?$"):
        _ = Trace(path).part.touch


def test_a_suggestion_does_not_list_many_labels(write: Write) -> None:
    path = write(f"{HEADER},label", *(f"{k / 100},1,2,3,4,5,6,w{k}" for k in range(300)))
    with pytest.raises(InputError, match=r"state labels\.unknown=WORD; .*labels\.unknown=WORD$"):
        _ = Trace(path, ColumnMap.parse("labels.slip=w1,labels.static=w2")).part.touch


def test_labels_of_slip_alone_are_a_warning(write: Write) -> None:
    for value, warned in (("", True), ("none", True), ("static", False)):
        path = write(f"{HEADER},label", "0,1,2,3,4,5,6,slip", f"1,1,2,3,4,5,6,{value}")
        assert ("no row is static: an empty label means unknown" in Trace(path).part.warnings) == warned


def test_pauses_are_a_warning(write: Write) -> None:
    times = [*range(0, 1000, 10), *range(3000, 3500, 10)]
    lines = [f"{time},{time % 7},2,3,4,5,6" for time in times]
    warning, *_ = Trace(write(f"t_ms{HEADER[1:]}", *lines)).part.warnings
    assert warning == "pauses: 1, up to 2.0 s, the first after line 101"
    again = write(f"t_ms{HEADER[1:]}", *lines, "5000,1,2,3,4,5,6")
    assert "pauses: 2, up to 2.0 s, the first after line 101" in Trace(again).part.warnings


def test_what_labels_mean_is_noted_and_a_label_that_no_row_has_is_a_warning(write: Write) -> None:
    values = ["Haften", "Rutschen", "Haften", "Unklar"]
    path = write(f"{HEADER},state", *(f"{k},1,2,3,4,5,6,{value}" for k, value in enumerate(values)))
    found = Trace(path, ColumnMap.parse("label=state,labels.slip=Rutschen"))
    assert found.part.notes[-1] == "slip: Rutschen; static: Haften, Unklar"
    assert not any("no row has" in each for each in found.part.warnings)
    wrong = Trace(path, ColumnMap.parse("label=state,labels.slip=rutscht")).part.warnings
    [warning] = [each for each in wrong if each.startswith("no row has the label 'rutscht'; the column has ")]
    assert "'Haften' (2), " in warning
    assert "'Rutschen' (1)" in warning


@pytest.mark.parametrize("kind", [dict, pl.DataFrame, pd.DataFrame])
def test_a_table_in_memory_is_a_trace(kind: Callable[[dict[str, object]], object]) -> None:
    time = np.arange(100) * 10_000_000
    columns = {"time_ns": time, "cell0": np.arange(100), "cell1": np.arange(100.0), "state": ["slip"] * 100}
    trace = Trace(kind(columns), ColumnMap.parse("label=state"), name="made.bin", about={"group": "wood"})
    assert trace.part.touch.time.tolist() == time.tolist()
    assert set(trace.part.labels.tolist()) == {1}
    assert trace.describe()["trace"] == "made.bin"
    assert trace.describe()["group"] == "wood"


def test_arrays_may_have_a_row_per_channel_two_fingertips_and_one_label() -> None:
    cells = 30_000 + 997 * np.arange(20).reshape(4, 5)  # (cells, n) as in MATLAB; more than 16 bits
    trace = Trace({"a": cells}, ColumnMap.parse("rate=100,counts.0=a0..a1,counts.1=a2..a3,labelled=slip"))
    assert trace.fingers(Touch) == (0, 1)
    second = concat(Touch, list(trace.read(Touch, 1)))
    assert (second.counts + trace.part.offset[2:]).tolist() == cells[2:].T.tolist()
    assert trace.part.labels.tolist() == [1] * 5


def test_arrays_of_several_columns_are_cells_and_other_data_is_refused() -> None:
    trace = Trace({"t": [0.0, 0.1], "cells": np.arange(6).reshape(2, 3)})
    assert trace.part.touch.counts.tolist() == [[0, 1, 2], [3, 4, 5]]
    with pytest.raises(InputError, match=r"pad: cannot become a DataFrame of polars: .*"):
        _ = Trace({"a": [1], "b": [1, 2]}, name="pad").part.touch
    with pytest.raises(InputError, match=r"column a cannot be used: its values are Object"):
        _ = Trace({"t": [0], "a": [object()]}, ColumnMap.parse("counts=a")).part.touch
    twice = {"t": [0.0, 0.1], "cells0": [7, 7], "cells": np.arange(4).reshape(2, 2)}
    with pytest.raises(InputError, match="column cells0 is also part of column cells: rename one"):
        _ = Trace(twice).part.touch
    with pytest.raises(InputError, match="table: has no rows"):
        _ = Trace({}).part.touch
    late = [{"t": k / 100, "p0": k, **({"v": 0.01} if k > 150 else {})} for k in range(200)]
    assert len(Trace(late).part.motion) == 49
    with pytest.raises(InputError, match="cells cannot be used: its values are Array"):
        _ = Trace({"t": [0.0, 0.1], "cells": np.ones((2, 2), complex)}).part
