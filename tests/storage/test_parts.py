import errno
import hashlib
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.batch import EVERY, Episodes, Motion, Touch
from operators.errors import EndpointError, InputError
from storage import arrow, files
from storage.layout import EPISODES, MOTION, TOUCH, Table
from storage.parts import read_part, write_part
from storage.schema import from_arrow, schema, to_arrow
from tests.storage.made import new_batch, new_episodes, same


@pytest.fixture(scope="session")
def rows() -> pa.Table:
    return to_arrow(TOUCH, [new_batch(Touch, 10)])


@pytest.fixture(scope="session")
def part(rows: pa.Table, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("part") / "part.parquet"
    write_part(path, rows)
    return path.read_bytes()


@settings(deadline=None)
@given(place=st.floats(0, 1), bit=st.integers(0, 7))
def test_a_flipped_bit_is_always_reported_by_the_sha256(
    part: bytes, tmp_path_factory: pytest.TempPathFactory, place: float, bit: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "flipped.parquet"
    path.write_bytes(_flipped(part, round(place * (len(part) - 1)), bit))
    with pytest.raises(InputError, match=r"flipped\.parquet: is damaged"):
        read_part(path, schema(TOUCH), hashlib.sha256(part).hexdigest())


def test_a_flipped_bit_in_any_byte_of_an_unlisted_part_never_becomes_a_wrong_value(
    part: bytes, rows: pa.Table, tmp_path: Path
) -> None:
    path = tmp_path / "flipped.parquet"
    for position in range(0, len(part), 3):
        path.write_bytes(_flipped(part, position, 3))
        with suppress(InputError):  # where it did not matter, such as in the name of the writing library
            assert read_part(path, schema(TOUCH)).equals(rows)


def test_a_flipped_bit_in_any_page_is_reported_without_a_manifest(part: bytes, tmp_path: Path) -> None:
    path = tmp_path / "flipped.parquet"
    group = pq.ParquetFile(pa.BufferReader(part)).metadata.row_group(0)
    for number in range(group.num_columns):
        column = group.column(number)
        end = column.data_page_offset + column.total_compressed_size
        damaged = bytearray(part)
        damaged[end - 1] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="CRC checksum verification failed"):
            read_part(path, schema(TOUCH))


def test_a_flipped_bit_in_the_footer_never_ends_the_process(part: bytes, tmp_path: Path) -> None:
    """pyarrow aborts if it is asked for a column whose level histograms contradict the schema."""
    path = tmp_path / "flipped.parquet"
    size = int.from_bytes(part[-8:-4], "little")
    for number in range(len(part) - 8 - size, len(part)):
        damaged = bytearray(part)
        damaged[number] ^= 1 << number % 8
        path.write_bytes(damaged)
        with suppress(InputError):
            read_part(path, schema(TOUCH))


@pytest.mark.parametrize("data", [b"", b"PAR1", b"PAR1PAR1", b"no parquet at all", bytes(1000)])
def test_a_file_that_is_not_parquet_is_reported(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "x.parquet").write_bytes(data)
    with pytest.raises(InputError, match=r"x\.parquet: is damaged or not a Parquet file"):
        read_part(tmp_path / "x.parquet", schema(TOUCH))


@settings(deadline=None)
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_part_cut_short_is_reported(
    part: bytes, tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "cut.parquet"
    path.write_bytes(part[: int(share * len(part))])
    with pytest.raises(InputError):
        read_part(path, schema(TOUCH))


def test_a_part_that_unpacks_to_too_much_is_refused_unread(tmp_path: Path) -> None:
    """A file of a few MB declares 60 million rows."""
    zeros = {"time": np.zeros(600_000, np.int64)}
    expected: pa.Schema = cast("Any", pa).schema([cast("Any", schema(TOUCH)).field("time")])
    path = tmp_path / "bomb.parquet"
    with cast("Any", pq).ParquetWriter(path, expected, compression="zstd") as writer:
        for _ in range(120):
            writer.write_table(cast("Any", pa).table(zeros, schema=expected))
    assert path.stat().st_size < 2_000_000
    before = pa.total_allocated_bytes()
    with pytest.raises(InputError, match="unpacks to more than 512 MiB"):
        read_part(path, expected)
    assert pa.total_allocated_bytes() == before


@pytest.mark.parametrize("error", [errno.EIO, errno.EMFILE, errno.ENOMEM])
def test_a_failing_disk_is_not_reported_as_damage(
    part: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int
) -> None:
    def fail(*_: object) -> bytes:
        raise OSError(error, os.strerror(error))

    (tmp_path / "x.parquet").write_bytes(part)
    monkeypatch.setattr(files, "read_at", fail)
    with pytest.raises(EndpointError, match=os.strerror(error)):
        read_part(tmp_path / "x.parquet", schema(TOUCH))


@pytest.mark.parametrize("error", [pa.ArrowMemoryError, MemoryError])
def test_a_lack_of_memory_is_not_reported_as_damage(
    part: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[Exception]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error("malloc of size 64 failed")

    (tmp_path / "x.parquet").write_bytes(part)
    monkeypatch.setattr(arrow.pq, "ParquetFile", fail)
    with pytest.raises(EndpointError, match="not enough memory"):
        read_part(tmp_path / "x.parquet", schema(TOUCH))


def test_a_missing_part_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        read_part(tmp_path / "x.parquet", schema(TOUCH))


def test_other_columns_are_reported_by_name(rows: pa.Table, tmp_path: Path) -> None:
    path = tmp_path / "x.parquet"
    counts = cast("Any", pa).array([[0.5] * 6] * len(rows), pa.list_(pa.float64(), 6))
    speed = pa.field("time", pa.int64(), nullable=False, metadata={"unit": "ms"})
    for table, complaint in (
        (rows.drop_columns(["counts"]), "has no column 'counts'; it has time, finger, temperature, valid"),
        (rows.set_column(2, "counts", counts), "column 'counts' is fixed_size_list<.*double>"),
        (rows.set_column(0, speed, rows["time"]), "column 'time' is in 'ms', must be in 'ns'"),
    ):
        write_part(path, table)
        with pytest.raises(InputError, match=complaint):
            read_part(path, schema(TOUCH))


def test_nulls_are_reported_in_rows_and_in_their_arrays(rows: pa.Table, tmp_path: Path) -> None:
    path = tmp_path / "x.parquet"
    for holed in (None, [None, 0, 0, 0, 0, 0]):
        counts = cast("Any", pa).array([holed] * len(rows), pa.list_(pa.int16(), 6))
        column = pa.field("counts", pa.list_(pa.int16(), 6), metadata={"unit": "count"})
        write_part(path, rows.set_column(2, column, counts))
        with pytest.raises(InputError, match="column 'counts' has nulls"):
            read_part(path, schema(TOUCH))


def test_further_columns_are_ignored(rows: pa.Table, tmp_path: Path) -> None:
    write_part(tmp_path / "x.parquet", rows.append_column("more", rows["time"]))
    assert read_part(tmp_path / "x.parquet", schema(TOUCH)).equals(rows)


def test_names_with_indices_of_another_type_are_read_as_pyarrow_16_returns_them(tmp_path: Path) -> None:
    rows: Any = to_arrow(EPISODES, [batch := new_episodes((0, 1, "hold"), (1, 2, "tap"))])
    for place, field in enumerate(rows.schema):
        if pa.types.is_dictionary(field.type):
            wide = field.with_type(pa.dictionary(pa.int32(), pa.string()))
            column = cast("Any", pa).array(rows[field.name].to_pylist(), wide.type)
            rows = rows.set_column(place, wide, column)
    write_part(tmp_path / "x.parquet", rows)
    read = read_part(tmp_path / "x.parquet", schema(EPISODES))
    same(from_arrow(EPISODES, Episodes, read)[EVERY], batch)


@pytest.mark.parametrize(("table", "kind"), [(TOUCH, Touch), (MOTION, Motion)])
def test_times_are_delta_packed_and_all_is_zstd(
    tmp_path: Path, table: Table, kind: type[Touch | Motion]
) -> None:
    path = tmp_path / "x.parquet"
    sha256 = write_part(path, to_arrow(table, [new_batch(kind, 1000)]))
    assert sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    group = pq.ParquetFile(path).metadata.row_group(0)
    columns = [group.column(number) for number in range(group.num_columns)]
    assert {column.compression for column in columns} == {"ZSTD"}
    times = [column for column in columns if column.path_in_schema.endswith("time")]
    assert times
    assert all("DELTA_BINARY_PACKED" in column.encodings for column in times)
    assert times[0].total_compressed_size < 200  # bytes, of 8000


def _flipped(data: bytes, position: int, bit: int) -> bytes:
    damaged = bytearray(data)
    damaged[position] ^= 1 << bit
    return bytes(damaged)


def test_a_part_is_read_without_arrow_s_own_threads(part: bytes, tmp_path: Path) -> None:
    """One that lets go of the file's bytes while the process ends would abort it."""
    path = tmp_path / "x.parquet"
    path.write_bytes(part)
    script = f"""
import os
from pathlib import Path
from storage import arrow
from storage.layout import TOUCH
from storage.parts import read_part
from storage.schema import schema
arrow.load()
before = len(os.listdir("/proc/self/task"))
read_part(Path({str(path)!r}), schema(TOUCH))
print(len(os.listdir("/proc/self/task")) - before)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "0\n"
