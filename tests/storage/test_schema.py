from pathlib import Path
from typing import Any, cast

import numpy as np
import polars as pl
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.batch import (
    EVERY,
    Batch,
    Clocks,
    Episodes,
    Faults,
    Labelled,
    Motion,
    Slips,
    Touch,
    Truth,
    Zeroed,
    columns,
    concat,
)
from operators.errors import BatchError, InputError
from storage.layout import EPISODES, SAMPLES, SLIPS, TABLE_OF, TABLES, Table
from storage.parts import write_part
from storage.schema import batch_type, from_arrow, schema, to_arrow
from tests.storage.made import new_batch, new_episodes, same
from tests.storage.test_parts import read

KINDS = [Touch, Zeroed, Motion, Labelled, Slips, Faults, Clocks, Episodes, Truth]


@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None)
@given(cuts=st.lists(st.tuples(st.integers(0, 2), st.integers(1, 9)), min_size=1, max_size=6))
def test_batches_come_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, kind: type[Batch], cuts: list[tuple[int, int]]
) -> None:
    batches = [new_batch(kind, rows, finger=finger, seed=rows) for finger, rows in cuts]
    table, folder = TABLE_OF[kind], tmp_path_factory.getbasetemp()
    write_part(folder, "round.parquet", to_arrow(table, batches))
    rows = read(folder / "round.parquet", schema(table))
    assert batch_type(rows) is kind
    found = from_arrow(table, kind, rows)
    assert list(found) == sorted({batch.finger for batch in batches})
    for finger, batch in found.items():
        same(batch, _as_stored(table, concat(kind, [each for each in batches if each.finger == finger])))


def test_columns_stand_in_the_order_that_the_dataset_promises() -> None:
    assert {table.name: schema(table).names for table in TABLES} == {
        "touch": ["time", "finger", "counts", "temperature", "valid"],
        "motion": ["time", "device_time", "velocity", "pose"],
        "samples": ["time", "finger", "counts", "valid", "velocity", "speed", "label"],
        "slips": ["time", "finger", "state", "start", "probability"],
        "faults": ["time", "finger", "barometer", "kind", "active"],
        "clocks": ["time", "offset", "drift", "residual"],
        "episodes": [
            *("time", "end", "motion", "surface", "direction", "speed", "angular_speed", "depth", "force")
        ],
        "truth": ["time", "finger", "sliding", "force", "velocity"],
    }


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_units_stand_in_the_field_metadata_of_the_file(tmp_path: Path, table: Table) -> None:
    write_part(tmp_path, "x.parquet", to_arrow(table, [new_batch(table.kind)]))
    found = read(tmp_path / "x.parquet", schema(table)).schema
    for name, column in table.columns.items():
        metadata: dict[bytes, bytes] = cast("Any", found).field(name).metadata or {}
        assert metadata.get(b"unit", b"").decode() == column.unit
    assert table.columns["time"].unit == "ns"


@pytest.mark.parametrize("kind", KINDS)
def test_polars_reads_arrays_with_their_width(tmp_path: Path, kind: type[Batch]) -> None:
    table, batch = TABLE_OF[kind], new_batch(kind)
    write_part(tmp_path, "x.parquet", to_arrow(table, [batch]))
    frame = pl.read_parquet(tmp_path / "x.parquet")
    for name, column in table.columns.items():
        expected: Any = getattr(batch, name)
        if column.names:
            assert frame[name].to_list() == [column.names[code] for code in expected]
            continue
        assert frame[name].to_numpy().tobytes() == expected.tobytes()


def test_columns_of_an_older_version_are_ignored_and_a_missing_one_is_named(tmp_path: Path) -> None:
    batch = new_batch(Slips)
    rows: Any = to_arrow(SLIPS, [batch])
    older = rows
    for name in ("doubt", "direction", "deviation"):
        older = older.append_column(pa.field(name, pa.float64(), nullable=False), rows["probability"])
    write_part(tmp_path, "x.parquet", older)
    same(from_arrow(SLIPS, Slips, read(tmp_path / "x.parquet", schema(SLIPS)))[batch.finger], batch)
    write_part(tmp_path, "y.parquet", rows.drop_columns(["probability"]))
    with pytest.raises(InputError, match="has no column 'probability'"):
        read(tmp_path / "y.parquet", schema(SLIPS))


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


def test_columns_that_samples_do_not_store_are_unknown() -> None:
    batch = new_batch(Labelled, 3)
    batch.velocity[1] = np.nan
    found = from_arrow(SAMPLES, Labelled, to_arrow(SAMPLES, [batch]))[0]
    assert isinstance(found, Labelled)
    assert (found.temperature == -1).all()
    assert np.isnan(found.pose).all()
    assert found.matched.tolist() == [True, False, True]


def _as_stored(table: Table, batch: Batch) -> Batch:
    values: dict[str, Any] = {name: getattr(batch, name) for name in columns(type(batch))}
    if table is SAMPLES:
        values["temperature"] = np.full_like(values["temperature"], -1)
        values["pose"] = np.full_like(values["pose"], np.nan)
        values["matched"] = ~np.isnan(values["velocity"]).all(axis=1)
    return type(batch)(*values.values(), finger=batch.finger)
