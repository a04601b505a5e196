from pathlib import Path

import numpy as np
import pytest

from connectors.files.csv_table import read_csv
from connectors.files.trace_table import TraceTable
from operators import InputError


def test_errors_name_the_lines_of_selected_rows(tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    path.write_text("t,a\n0,1\n1,x\n2,3\n3,y\n")
    table = read_csv(path).selected(np.array([True, False, True, True]))
    assert len(table) == 3
    np.testing.assert_array_equal(table.times("t", "s"), [0, 2_000_000_000, 3_000_000_000])
    with pytest.raises(InputError, match=r"line 5, column a: is 'y'"):
        table.reals("a")
    with pytest.raises(InputError, match=r"line 5, column a: is 'y'"):
        table.selected(np.array([False, True, True])).reals("a")


def test_selected_rows_of_arrays_keep_their_numbers_and_the_header() -> None:
    table = TraceTable({"a": np.array([0.0, 1.0, np.inf])}, "given").selected(np.array([False, True, True]))
    table.header.check("a")
    with pytest.raises(InputError, match="row 2, column a"):
        table.reals("a")


def test_no_selected_row_is_an_error() -> None:
    with pytest.raises(InputError, match="given: has no valid row"):
        TraceTable({"a": np.zeros(2)}, "given").selected(np.zeros(2, np.bool_))


def test_a_last_line_that_is_cut_off_is_read_on_request(tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    path.write_text("t,a\n0,1\n1")
    with pytest.raises(InputError, match="cut off"):
        read_csv(path)
    np.testing.assert_array_equal(read_csv(path, lenient=True).reals("a"), [1.0, np.nan])
