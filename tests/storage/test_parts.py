"""Parquet files of a session and their manifest: written as promised, refused if damaged."""

import errno
import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.batch import EVERY, Episodes, Touch
from operators.errors import BatchError, EndpointError, InputError
from storage import arrow
from storage.layout import EPISODES, MOTION, TOUCH, file_name
from storage.parts import Part, read_manifest, read_part, write_manifest, write_part
from storage.schema import from_arrow, to_arrow
from tests.storage.made import new_batch, new_episodes, same

PATH = "touch/part-000000.parquet"
GOOD: dict[str, Any] = {
    "path": PATH,
    "rows": 3,
    "first": 1,
    "last": 5,
    "sha256": "0f" * 32,
}


@pytest.fixture(scope="session")
def rows() -> pa.Table:
    return to_arrow(TOUCH, [new_batch(Touch, 10)])


@pytest.fixture(scope="session")
def data(rows: pa.Table, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Content of a part."""
    folder = tmp_path_factory.mktemp("part")
    write(folder, rows)
    return (folder / PATH).read_bytes()


def write(folder: Path, rows: pa.Table, path: str = PATH) -> Part:
    (folder / path).parent.mkdir(exist_ok=True)
    return write_part(folder, path, rows)


def read(folder: Path) -> pa.Table:
    """Read a file that the manifest lists with its sha256."""
    return read_part(folder, Part(PATH, 0, 0, 0, hashlib.sha256((folder / PATH).read_bytes()).hexdigest()))


@settings(deadline=None)
@given(place=st.floats(0, 1), bit=st.integers(0, 7), cut=st.booleans())
def test_a_flipped_bit_or_a_cut_is_always_reported(
    data: bytes, tmp_path_factory: pytest.TempPathFactory, place: float, bit: int, *, cut: bool
) -> None:
    folder, position = tmp_path_factory.getbasetemp(), round(place * (len(data) - 1))
    damaged = bytearray(data[:position] if cut else data)
    if not cut:
        damaged[position] ^= 1 << bit
    (folder / PATH).parent.mkdir(exist_ok=True)
    (folder / PATH).write_bytes(damaged)
    with pytest.raises(InputError, match=r"part-000000\.parquet: is damaged"):
        read_part(folder, Part(PATH, 10, 0, 0, hashlib.sha256(data).hexdigest()))


@pytest.mark.parametrize("content", [b"", b"PAR1PAR1", b"no parquet at all"])
def test_a_file_that_is_not_parquet_is_reported(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "touch").mkdir()
    (tmp_path / PATH).write_bytes(content)
    with pytest.raises(InputError, match=r"part-000000\.parquet: is damaged or not a Parquet file"):
        read(tmp_path)


def test_a_part_that_unpacks_to_too_much_is_refused_unread(tmp_path: Path) -> None:
    """A file of a few MB declares 72 million rows."""
    zeros = to_arrow(TOUCH, [Touch.zeros(600_000)])
    (tmp_path / "touch").mkdir()
    with cast("Any", pq).ParquetWriter(tmp_path / PATH, zeros.schema, compression="zstd") as writer:
        for _ in range(24):
            writer.write_table(zeros)
    assert (tmp_path / PATH).stat().st_size < 2_000_000
    del zeros
    before = pa.total_allocated_bytes()
    with pytest.raises(InputError, match="unpacks to more than 512 MiB"):
        read(tmp_path)
    assert pa.total_allocated_bytes() == before


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


def test_other_columns_and_nulls_are_reported_by_name_and_further_ones_ignored(
    rows: pa.Table, tmp_path: Path
) -> None:
    counts = cast("Any", pa).array([[0.5] * 6] * len(rows), pa.list_(pa.float64(), 6))
    holed = cast("Any", pa).array([[None, 0, 0, 0, 0, 0]] * len(rows), pa.list_(pa.int16(), 6))
    column = pa.field("counts", pa.list_(pa.int16(), 6), metadata={"unit": "count"})
    time = pa.field("time", pa.int64(), nullable=False, metadata={"unit": "ms"})
    for table, complaint in (
        (rows.drop_columns(["counts"]), "has no column 'counts'; it has time, finger, temperature, valid"),
        (rows.set_column(2, "counts", counts), "column 'counts' is fixed_size_list<.*double>"),
        (rows.set_column(0, time, rows["time"]), "column 'time' is in 'ms', must be in 'ns'"),
        (rows.set_column(2, column, holed), "column 'counts' has nulls"),
    ):
        part = write(tmp_path, table)
        with pytest.raises(InputError, match=complaint):
            read_part(tmp_path, part)
    part = write(tmp_path, rows.append_column("more", rows["time"]))
    assert read_part(tmp_path, part).equals(rows)
    with pytest.raises(InputError, match="has other rows or times than in the manifest"):
        read_part(tmp_path, replace(part, rows=9))


def test_names_with_indices_of_another_type_are_read_as_pyarrow_16_returns_them(tmp_path: Path) -> None:
    table: Any = to_arrow(EPISODES, [batch := new_episodes((0, 1, "hold"), (1, 2, "tap"))])
    for place, field in enumerate(table.schema):
        if pa.types.is_dictionary(field.type):
            wide = field.with_type(pa.dictionary(pa.int32(), pa.string()))
            column = cast("Any", pa).array(table[field.name].to_pylist(), wide.type)
            table = table.set_column(place, wide, column)
    part = write(tmp_path, table, "episodes.parquet")
    same(from_arrow(EPISODES, Episodes, read_part(tmp_path, part))[EVERY], batch)


times = st.integers(-(2**63), 2**63 - 1)


@st.composite
def parts(draw: st.DrawFn) -> Part:
    first, last = sorted([draw(times), draw(times)])
    sha256 = draw(st.binary(min_size=32, max_size=32)).hex()
    return Part(
        file_name(MOTION.pattern, draw(st.integers(0, 10_000_000))),
        draw(st.integers(1, 2**40)),
        first,
        last,
        sha256,
    )


@settings(deadline=None)
@given(listed=st.lists(parts(), unique_by=lambda part: part.path))
def test_a_manifest_comes_back_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, listed: list[Part]
) -> None:
    folder = tmp_path_factory.getbasetemp()
    write_manifest(folder, listed)
    assert list(read_manifest(folder).values()) == listed


def test_a_manifest_is_empty_only_where_no_part_exists(tmp_path: Path) -> None:
    assert read_manifest(tmp_path) == {}
    nothing = Part("slips.parquet", 0, 0, 0, "0f" * 32)
    write_manifest(tmp_path, [nothing])
    assert read_manifest(tmp_path) == {"slips.parquet": nothing}
    (tmp_path / "MANIFEST.json").rename(tmp_path / "slips.parquet")
    with pytest.raises(InputError, match=r"MANIFEST\.json: cannot be read: No such file"):
        read_manifest(tmp_path)


@pytest.mark.parametrize(
    "changes",
    [
        {"more": 1},
        {"rows": 3.0},
        {"rows": 0},
        {"rows": 0, "first": 0, "last": 0},
        {"path": "slips.parquet", "rows": 0},
        {"first": 6},
        {"sha256": "0f"},
        {"sha256": "0F" * 32},
        {"path": "../touch/part-000000.parquet"},
        {"path": "/etc/passwd"},
        {"path": "touch/part-000000.parquet\n"},
        {"path": "touch/../motion/part-000000.parquet"},
        {"path": 7},
    ],
)
def test_an_impossible_part_is_refused_by_its_number(tmp_path: Path, changes: dict[str, Any]) -> None:
    impossible: tuple[Any, ...] = (GOOD | changes, changes, None)
    for part in impossible:
        (tmp_path / "MANIFEST.json").write_text(json.dumps({"version": 2, "parts": [GOOD, part]}))
        with pytest.raises(InputError, match=r"MANIFEST\.json, part 1: "):
            read_manifest(tmp_path)


def test_codes_are_stored_by_name_and_come_back_whatever_codes_the_file_uses() -> None:
    batch = new_episodes((0, 1, "hold"), (1, 2, "tap"), (2, 3, "hold"))
    rows: Any = to_arrow(EPISODES, [batch])
    assert rows["motion"].to_pylist() == ["hold", "tap", "hold"]
    [motion] = (
        rows["motion"].cast(pa.string()).dictionary_encode().cast(rows.schema.field("motion").type).chunks
    )
    assert motion.indices.to_pylist() == [0, 1, 0]
    rows = rows.set_column(2, rows.schema.field("motion"), motion)
    same(from_arrow(EPISODES, Episodes, rows)[EVERY], batch)


def test_a_name_without_a_code_is_refused() -> None:
    rows: Any = to_arrow(EPISODES, [new_episodes((0, 1, "hold"))])
    field = rows.schema.field("motion")
    names: Any = pa.array(["dance"])
    rows = rows.set_column(2, field, names.dictionary_encode().cast(field.type))
    with pytest.raises(BatchError, match=r"Episodes\.motion: holds 'dance', must be one of translation"):
        from_arrow(EPISODES, Episodes, rows)
