from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from operators.batch import (
    EVERY,
    Clocks,
    Episodes,
    Faults,
    Labelled,
    Motion,
    Slips,
    Touch,
    Truth,
    Zeroed,
)
from operators.errors import BatchError, InputError
from storage.layout import EPISODES, SLIPS
from storage.parts import write_part
from storage.schema import from_arrow, schema, to_arrow
from tests.storage.made import new_batch, new_episodes, same
from tests.storage.test_parts import read

KINDS = [Touch, Zeroed, Motion, Labelled, Slips, Faults, Clocks, Episodes, Truth]


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
