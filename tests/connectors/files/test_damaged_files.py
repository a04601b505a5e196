"""Damaged files of all formats."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from connectors.files.formats import read_table
from operators.errors import InputError

TIME = np.arange(20) / 100


def write_csv(path: Path) -> None:
    path.write_text("t,p0,p1\n" + "".join(f"{time},1,2\n" for time in TIME))


def write_parquet(path: Path) -> None:
    frame = pl.DataFrame({"t": TIME, "p0": range(20), "p1": ["a", "b"] * 10, "p2": [[1, 2]] * 20})
    frame.write_parquet(path)


def write_npz(path: Path) -> None:
    np.savez_compressed(path, t=TIME, p0=np.arange(20), p1=np.array(list("abcdefghijklmnopqrst")))


def write_mcap(path: Path) -> None:
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema = writer.register_schema("pad", "jsonschema", b"{}")
        channel = writer.register_channel("/pad", "json", schema)
        for row in range(20):
            writer.add_message(channel, row, b'{"p0": 1, "p1": [1, 2], "p2": "a"}', row)
        writer.finish()


FORMATS = {".csv": write_csv, ".parquet": write_parquet, ".npz": write_npz, ".mcap": write_mcap}


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


@pytest.mark.parametrize("ending", FORMATS)
@given(content=st.binary(max_size=300))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_any_content_is_read_or_refused_in_one_line(ending: str, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / f"trace{ending}"
    path.write_bytes(content)
    assert "\n" not in refusal(path)
