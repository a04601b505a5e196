"""Parquet files of a session and their manifest: written as promised, refused if damaged."""

import errno
import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pyarrow as pa
import pytest

from operators.batch import EVERY, Episodes, Touch, packed_type
from operators.errors import BatchError, EndpointError, InputError
from storage import arrow, parts
from storage.layout import EPISODES, TOUCH
from storage.parts import Part, read_manifest, read_part, write_part
from storage.schema import from_arrow, to_arrow
from tests.storage.made import new_batch, new_episodes, same

PATH = "touch/part-000000.parquet"
GOOD: dict[str, Any] = {"path": PATH, "rows": 3, "first": 1, "last": 5, "sha256": "0f" * 32}


@pytest.fixture(scope="session")
def rows() -> pa.Table:
    return to_arrow(TOUCH, [new_batch(Touch, 10)])


def write(folder: Path, rows: pa.Table, path: str = PATH) -> Part:
    (folder / path).parent.mkdir(exist_ok=True)
    return write_part(folder, path, rows)


def read(folder: Path) -> pa.Table:
    """Read a file that the manifest lists with its sha256."""
    return read_part(folder, Part(PATH, 0, 0, 0, hashlib.sha256((folder / PATH).read_bytes()).hexdigest()))


@pytest.mark.parametrize("content", [b"", b"PAR1PAR1", b"no parquet at all"])
def test_a_file_that_is_not_parquet_is_reported(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "touch").mkdir()
    (tmp_path / PATH).write_bytes(content)
    with pytest.raises(InputError, match=r"part-000000\.parquet: is damaged or not a Parquet file"):
        read(tmp_path)


def test_a_part_that_unpacks_to_too_much_is_refused_unread(
    rows: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = write(tmp_path, rows)
    monkeypatch.setattr(parts, "UNPACKED_LIMIT", len(rows) * packed_type(Touch).itemsize - 1)
    monkeypatch.delattr(arrow.pq.ParquetFile, "read")
    with pytest.raises(InputError, match="unpacks to more than 0 MiB"):
        read_part(tmp_path, part)


def test_a_failing_disk_or_a_lack_of_memory_is_not_reported_as_damage(
    rows: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail_disk(*_: object) -> bytes:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    def fail_memory(*_: object, **__: object) -> None:
        raise pa.ArrowMemoryError("malloc of size 64 failed")

    part = write(tmp_path, rows)
    with monkeypatch.context() as patch:
        patch.setattr(os, "pread", fail_disk)
        with pytest.raises(EndpointError, match="Input/output error"):
            read_part(tmp_path, part)
    monkeypatch.setattr(arrow.pq, "ParquetFile", fail_memory)
    with pytest.raises(EndpointError, match="not enough memory"):
        read_part(tmp_path, part)


def test_other_columns_and_nulls_are_named_and_further_ones_ignored(rows: pa.Table, tmp_path: Path) -> None:
    counts = cast("Any", pa).array([[0.5] * 6] * len(rows), pa.list_(pa.float64(), 6))
    holed = cast("Any", pa).array([[None, 0, 0, 0, 0, 0]] * len(rows), pa.list_(pa.int16(), 6))
    column = pa.field("counts", pa.list_(pa.int16(), 6), metadata={"unit": "count"})
    time = pa.field("time", pa.int64(), nullable=False, metadata={"unit": "ms"})
    for table, complaint in (
        (rows.drop_columns(["counts"]), "has no column 'counts'; it has time, finger, temperature, valid"),
        (rows.set_column(2, "counts", counts), "column 'counts' is fixed_size_list<.*double>"),
        (rows.set_column(0, time, rows["time"]), "column 'time' is in 'ms', must be in 'ns'"),
        (rows.set_column(2, column, holed), "column 'counts' has nulls"),
        (rows.append_column(column, rows["counts"]), "has several columns 'counts'"),
    ):
        part = write(tmp_path, table)
        with pytest.raises(InputError, match=complaint):
            read_part(tmp_path, part)
    part = write(tmp_path, rows.append_column("more", rows["time"]))
    assert read_part(tmp_path, part).equals(rows)
    with pytest.raises(InputError, match="has other rows or times than in the manifest"):
        read_part(tmp_path, replace(part, rows=9))


@pytest.mark.parametrize(
    "changes",
    [
        {"more": 1},
        {"rows": 3.0},
        {"rows": 0},
        {"rows": 0, "first": 0, "last": 0},
        {"path": "slips.parquet", "rows": 0},
        {"sha256": "0f"},
        {"sha256": "0F" * 32},
        {"path": "../touch/part-000000.parquet"},
        {"path": "/etc/passwd"},
        {"path": "touch/part-000000.parquet\n"},
        {"path": "touch/../motion/part-000000.parquet"},
    ],
)
def test_an_impossible_part_is_refused_by_its_number(tmp_path: Path, changes: dict[str, Any]) -> None:
    impossible: tuple[Any, ...] = (GOOD | changes, changes, None)
    for part in impossible:
        (tmp_path / "MANIFEST.json").write_text(json.dumps({"version": 2, "parts": [GOOD, part]}))
        with pytest.raises(InputError, match=r"MANIFEST\.json, part 1: "):
            read_manifest(tmp_path)


def test_codes_are_stored_by_name_and_read_back_whatever_codes_and_indices_a_file_has(tmp_path: Path) -> None:
    batch = new_episodes((0, 1, "hold"), (1, 2, "tap"), (2, 3, "hold"))
    rows: Any = to_arrow(EPISODES, [batch])
    assert rows["motion"].to_pylist() == ["hold", "tap", "hold"]
    for index in (pa.int32(), pa.int8()):  # pyarrow 16 returns int32 for all
        for place, field in enumerate(rows.schema):
            if pa.types.is_dictionary(field.type):
                names = rows[field.name].cast(pa.string()).dictionary_encode()  # in order of appearance
                column = names.cast(pa.dictionary(index, pa.string()))
                rows = rows.set_column(place, field.with_type(column.type), column)
        part = write(tmp_path, rows, "episodes.parquet")
        same(from_arrow(EPISODES, Episodes, read_part(tmp_path, part))[EVERY], batch)
    dance: Any = pa.array(["dance"] * 3)
    rows = rows.set_column(rows.schema.get_field_index("motion"), "motion", dance.dictionary_encode())
    with pytest.raises(BatchError, match=r"Episodes\.motion: holds 'dance', must be one of translation"):
        from_arrow(EPISODES, Episodes, rows)
