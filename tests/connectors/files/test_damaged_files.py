"""Damaged files, and files of other formats."""

import os
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from connectors.files.container import read_table
from operators.errors import InputError

TIME = np.arange(20) / 100


def write_csv(path: Path) -> None:
    path.write_text("t,p0,p1\n" + "".join(f"{time},1,2\n" for time in TIME))


def write_parquet(path: Path) -> None:
    frame = pl.DataFrame({"t": TIME, "p0": range(20), "p1": ["a", "b"] * 10, "p2": [[1, 2]] * 20})
    frame.write_parquet(path)


FORMATS = {".csv": write_csv, ".parquet": write_parquet}


def refusal(path: Path) -> str:
    """Return the error with which a file is refused; empty if it is read."""
    try:
        read_table(path)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("ending", "write"), FORMATS.items())
@given(data=st.data())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_a_damaged_file_is_read_or_refused_in_one_line(
    ending: str, write: Callable[[Path], None], tmp_path: Path, data: st.DataObject
) -> None:
    path = tmp_path / f"trace{ending}"
    write(path)
    assert not refusal(path)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    assert "\n" not in refusal(path)


PYTHON = "read it in Python ({}) and pass a DataFrame to import_frame, see docs/how-to/import.md"


@pytest.mark.parametrize(
    ("first", "name", "remedy"),
    [
        (b"\x89MCAP0\r\n", "an MCAP file", PYTHON.format("mcap_json.py, or bag.py for ROS messages")),
        (b"SQLite format 3\0", "a ROS 2 bag or another SQLite file", PYTHON.format("bag.py")),
        (b"#ROSBAG V2.0\n", "a ROS 1 bag", PYTHON.format("bag.py")),
        (b"PK\x03\x04" + bytes(26) + b"time.npy", "an NPZ file", PYTHON.format("arrays.py")),
        (b"PK\x03\x04" + bytes(26) + b"xl/workbook.xml", "an Excel file", "save it as CSV"),
        (b"PK\x03\x04", "a ZIP file", "unpack it"),
        (b"MATLAB 5.0 MAT-file", "a MATLAB file", PYTHON.format("arrays.py")),
        (b"\x89HDF\r\n\x1a\n", "an HDF5 file", PYTHON.format("arrays.py")),
        (b"\x93NUMPY\x01\0", "an array of numpy", PYTHON.format("arrays.py")),
        (b"MATLAB 7.3", "a MATLAB file of version 7.3, which is HDF5", PYTHON.format("arrays.py")),
        (b'{"t": [0, 1]}', "a JSON file", PYTHON.format("polars.read_json")),
        (b"\x80\x04\x95", "a pickle of Python", PYTHON.format("pandas.read_pickle, if you trust its origin")),
        (b'[{"t": 0, "p": 1}]', "a JSON file", PYTHON.format("polars.read_json")),
        (b"[[0, 1], [2, 3]]", "a JSON file", PYTHON.format("polars.read_json")),
        (b"ARROW1\0\0", "a Feather or Arrow file", PYTHON.format("polars.read_ipc")),
        (b"%PDF-1.7", "an XML, HTML or PDF file", "save its table as CSV"),
        (b"<html>", "an XML, HTML or PDF file", "save its table as CSV"),
        (b"TDSm\x0e\0", "a TDMS or PX4 file", "save its table as CSV"),
        (b"\x28\xb5\x2f\xfd", "compressed", "decompress it, or use gzip"),
        (zlib.compress(b"t,p0\n0,1\n"), "compressed", "decompress it, or use gzip"),
    ],
)
def test_another_format_is_named_with_the_remedy(
    tmp_path: Path, first: bytes, name: str, remedy: str
) -> None:
    path = tmp_path / "trace.csv"
    path.write_bytes(first + bytes(50))
    assert refusal(path) == f"{path}: is {name}: {remedy}"


@pytest.mark.parametrize("name", ["x^2", "[0]", "{0}", "<TIME>", "TDSm", "BZh", "ARROW1", "Rar!"])
@pytest.mark.parametrize("sign", [",", ";", "\t"])
def test_a_column_may_be_named_like_another_format(name: str, sign: str, tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    path.write_text(sign.join((name, "[1]", "t")) + "\n" + sign.join("123") + "\n")
    assert [*read_table(path).columns] == [name, "[1]", "t"]


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    assert refusal(tmp_path / "pipe.csv").endswith("is not a regular file")
