from pathlib import Path
from typing import Any, cast

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.batch import Batch, Clocks, Faults, Labelled, Motion, Slips, Touch, Zeroed, columns, concat
from storage.episodes import Episodes
from storage.layout import SAMPLES, TABLE_OF, TABLES, Table
from storage.parts import read_part, write_part
from storage.schema import batch_type, from_arrow, schema, to_arrow
from tests.storage.made import new_batch, same

KINDS = [Touch, Zeroed, Motion, Labelled, Slips, Faults, Clocks]
NONE = Episodes.described({})


@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None)
@given(cuts=st.lists(st.tuples(st.integers(0, 2), st.integers(1, 9)), min_size=1, max_size=6))
def test_batches_come_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, kind: type[Batch], cuts: list[tuple[int, int]]
) -> None:
    batches = [new_batch(kind, rows, finger=finger, seed=rows) for finger, rows in cuts]
    table, path = TABLE_OF[kind], tmp_path_factory.getbasetemp() / "round.parquet"
    write_part(path, to_arrow(table, batches, NONE))
    rows = read_part(path, schema(table))
    assert batch_type(rows) is kind
    found = from_arrow(table, kind, rows)
    assert list(found) == sorted({batch.finger for batch in batches})
    for finger, batch in found.items():
        same(batch, _as_stored(table, concat(kind, [each for each in batches if each.finger == finger])))


def test_columns_stand_in_the_order_that_the_dataset_promises() -> None:
    assert {table.name: schema(table).names for table in TABLES} == {
        "touch": ["time", "finger", "counts", "temperature", "valid"],
        "motion": ["time", "device_time", "velocity", "pose"],
        "samples": ["time", "finger", "counts", "valid", "velocity", "speed", "label", "episode"],
        "slips": ["time", "finger", "state", "start", "probability"],
        "faults": ["time", "finger", "barometer", "kind", "active"],
        "clocks": ["time", "offset", "drift", "residual"],
    }


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_units_stand_in_the_field_metadata_of_the_file(tmp_path: Path, table: Table) -> None:
    write_part(tmp_path / "x.parquet", to_arrow(table, [new_batch(table.kind)], NONE))
    found = read_part(tmp_path / "x.parquet", schema(table)).schema
    for name, column in table.columns.items():
        metadata: dict[bytes, bytes] = cast("Any", found).field(name).metadata or {}
        assert metadata.get(b"unit", b"").decode() == column.unit
    assert table.columns["time"].unit == "ns"


@pytest.mark.parametrize("kind", KINDS)
def test_polars_reads_arrays_with_their_width(tmp_path: Path, kind: type[Batch]) -> None:
    table, batch = TABLE_OF[kind], new_batch(kind)
    write_part(tmp_path / "x.parquet", to_arrow(table, [batch], NONE))
    frame = pl.read_parquet(tmp_path / "x.parquet")
    for name in table.columns:
        expected: Any = getattr(batch, name)
        assert frame[name].to_numpy().tobytes() == expected.tobytes()


def test_samples_carry_the_number_of_their_episode() -> None:
    batch = new_batch(Labelled, 6)
    episodes = Episodes.described(
        {"rig": {"episodes": [{"start": int(batch.time[1]), "end": int(batch.time[3])}]}}
    )
    assert to_arrow(SAMPLES, [batch], episodes)["episode"].to_pylist() == [-1, 0, 0, -1, -1, -1]


def test_what_samples_do_not_keep_comes_back_as_unknown() -> None:
    batch = new_batch(Labelled, 3)
    batch.velocity[1] = np.nan
    found = from_arrow(SAMPLES, Labelled, to_arrow(SAMPLES, [batch], NONE))[0]
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
