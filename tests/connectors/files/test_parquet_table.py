"""Traces in Parquet files."""

import datetime as dt
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.interpretation import speeds_of
from operators.batch import Motion, Touch, Zeroed, s
from operators.errors import InputError
from storage.arrow import pa, pq

SHARED = Path(__file__).parents[3].parent / "shared/real"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "trace.parquet"


def put(path: Path, **columns: Any) -> Path:
    pl.DataFrame(columns).write_parquet(path)
    return path


def test_columns_of_any_type_are_read(path: Path) -> None:
    put(
        path,
        timestamp=[dt.datetime(2026, 1, 1, 0, 0, k, 1000, dt.UTC) for k in range(4)],
        cells=pl.Series([[1, 2], [3, 4], [5, 6], [7, 8]], dtype=pl.Array(pl.Int16, 2)),
        tcp=pl.Series([{"vx": 0.1 * k, "vy": 0.0, "vz": 0.0} for k in range(4)]),
        state=["Slip", "static", None, "STATIC"],
        raw=[b"1", b"2", b"3", b"4"],
    )
    columns = ColumnMap.parse("counts=cells0..cells1,velocity=tcp.vx,tcp.vy,tcp.vz,label=state")
    trace = Trace(path, columns)
    assert trace.part.touch.counts.tolist() == [[1, 2], [3, 4], [5, 6], [7, 8]]
    assert trace.part.touch.time[0] == 1767225600_001000000
    assert speeds_of(trace.part.motion) == pytest.approx([0, 0.1, 0.2, 0.3])
    assert trace.part.labels.tolist() == [1, 0, -1, 0]
    with pytest.raises(InputError, match="column raw cannot be used: its values are Binary"):
        _ = Trace(path, ColumnMap.parse("counts=raw")).part.touch


def test_columns_of_rare_types_are_read_or_left_out(path: Path) -> None:
    time, cells = np.arange(50) * 10_000_000, {"p0": np.arange(50), "p1": np.arange(50) % 7}
    passed = pa.array(time, pa.duration("ns"))
    for columns in (
        {"elapsed": passed, **cells},
        {
            "t": time / s,
            "since": passed,
            **cells,
            "note": pa.array([[("a", 1.0)]] * 50, pa.map_(pa.string(), pa.float64())),
        },
    ):
        pq.write_table(pa.table(columns), path)
        assert Trace(path).part.touch.time.tolist() == time.tolist()
    pq.write_table(pa.table([pa.array(time / s), *cells.values(), passed], [*"t", *cells, "p0"]), path)
    with pytest.raises(InputError, match="column p0 cannot be used: it occurs twice"):
        _ = Trace(path).part


def test_an_invalid_value_is_named_by_row_and_column(path: Path) -> None:
    cells = {f"p{k}": [1.0, None, 3.0, float("inf")] for k in range(2)}
    put(path, t=[0.0, 1.0, 2.0, 3.0], **cells)
    with pytest.raises(InputError, match=r"parquet, row 3, column p0: is inf, must be a number, without"):
        _ = Trace(path).part.touch  # once for all cells
    for times, row, must_be in (
        ([0.0, float("nan"), 2.0], 1, "a time in s"),
        ([0.0, None, 2.0], 1, "a time in s"),
        ([0.0, 1e300, 2.0], 1, "a time in s"),
        ([0.0, 2.0, 1.0], 1, "in order: sort the rows by time"),
    ):
        put(path, t=times, p0=[1, 2, 3], p1=[1, 2, 3])
        with pytest.raises(InputError, match=rf"row {row}, column t: is \S+, must be {must_be}"):
            _ = Trace(path).part.touch


@pytest.mark.parametrize(
    ("folder", "columns", "rows"),
    [
        ("strokes", ColumnMap.parse("time=t,counts=b0..b5,speed=speed,label=label"), 89_186),
        ("grasps", ColumnMap.parse("counts=b0..b5,velocity=vx,vy,vz"), 2195),
        ("barometers", ColumnMap.parse("label=,units.counts=Pa"), 230_068),
        ("mat_trace.csv", ColumnMap(), 377),
    ],
)
def test_the_real_recordings_are_read_whole(folder: str, columns: ColumnMap, rows: int) -> None:
    files = sorted(SHARED.glob(f"{folder}/*.parquet" if "." not in folder else folder))
    if not files:
        pytest.skip(f"{SHARED / folder} is missing: the shared material belongs next to the checkout")
    read = 0
    for file in files:
        trace = Trace(pl.read_parquet(file).drop_nulls("time") if folder == "barometers" else file, columns)
        read += len(trace.part.touch)
        names = trace.part.columns.columns["counts"]
        table = pl.read_csv(file) if file.suffix == ".csv" else pl.read_parquet(file)
        given = table.drop_nulls(trace.part.columns.columns["time"])[list(names)].to_numpy()
        stored = (trace.part.touch.counts + trace.part.offset) * trace.part.resolution
        valid = trace.part.touch.valid
        assert np.abs(stored - given)[valid].max() <= trace.part.resolution / 2
        assert valid.mean() > 0.999
        assert bool(trace.fingers(Touch))
        assert bool(trace.fingers(Motion)) == (folder in ("strokes", "grasps"))
        assert bool(trace.fingers(Zeroed)) == (folder != "barometers")
    assert read == rows
