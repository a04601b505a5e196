"""Damaged files, and files of other formats."""

import os
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


PYTHON = "read it in Python and pass a DataFrame to import_frame, see docs/how-to/import.md"
ARRAYS = f"{PYTHON} (arrays.py)"


@pytest.mark.parametrize(
    ("first", "name", "remedy"),
    [
        (b"\x89MCAP0\r\n", "an MCAP file", f"{PYTHON} (mcap_json.py, or bag.py for ROS messages)"),
        (b"SQLite format 3\0", "a ROS 2 bag or another SQLite file", f"{PYTHON} (bag.py)"),
        (b"#ROSBAG V2.0\n", "a ROS 1 bag", f"{PYTHON} (bag.py)"),
        (b"PK\x03\x04" + bytes(26) + b"time.npy", "an NPZ file", ARRAYS),
        (b"PK\x03\x04", "an Excel file or an archive", "save it as CSV, or unpack it"),
        (b"MATLAB 5.0 MAT-file", "a MATLAB file", ARRAYS),
        (b"\x89HDF\r\n\x1a\n", "an HDF5 file", ARRAYS),
        (b"\x93NUMPY\x01\0", "an array of numpy", ARRAYS),
        (b'{\n "t": [0, 1]}', "a JSON file", f"{PYTHON} (polars.read_json)"),
        (b"[[0, 1], [2, 3]]", "a JSON file", f"{PYTHON} (polars.read_json)"),
        (b"%PDF-1.7", "an XML, HTML or PDF file", "save its table as CSV"),
        (b"<html>", "an XML, HTML or PDF file", "save its table as CSV"),
        (
            b"\xfd7zXZ",
            "no text, it has bytes of zero",
            f"decompress it, save it as CSV in UTF-8, or {PYTHON}",
        ),
    ],
)
def test_another_format_is_named_with_the_remedy(
    tmp_path: Path, first: bytes, name: str, remedy: str
) -> None:
    path = tmp_path / "trace.csv"
    path.write_bytes(first + bytes(50))
    assert refusal(path) == f"{path}: is {name}: {remedy}"


@pytest.mark.parametrize("name", ["[0]", "{0}", "<TIME>", "PK", "MATLAB"])
@pytest.mark.parametrize("sign", [",", ";", "\t"])
def test_a_column_may_be_named_like_another_format(name: str, sign: str, tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    path.write_text(sign.join((name, "[1]", "t")) + "\n" + sign.join("123") + "\n")
    assert [*read_table(path).columns] == [name, "[1]", "t"]


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    assert refusal(tmp_path / "pipe.csv").endswith("is not a regular file")
