from pathlib import Path
from typing import Any

import pytest

from storage.layout import segment_file
from storage.manifest import Part
from storage.orphan_parts import missing_parts, missing_rows, missing_segments

PARTS = [Part(f"touch/part-{number:06d}.parquet", 10, 0, 9, "0" * 64) for number in range(3)]
SLIPS = Part("slips.parquet", 5, 0, 9, "0" * 64)


@pytest.mark.parametrize(
    ("sinks", "told"),
    [
        ({"dataset": {"rows": 35, "records": True}}, ""),
        ({"dataset": {"rows": 34, "records": True}}, ""),
        (
            {"lab": {"rows": 1039, "records": True}, "mqtt": {"rows": 9999, "records": False}},
            "1,004 of the 1,039 recorded rows",
        ),
        ({"one": {"rows": 40, "records": True}, "two": {"rows": 40, "records": True}}, ""),  # unknown which
        ({"dataset": 3}, ""),
        ([], ""),
    ],
)
def test_rows_that_no_part_holds_are_counted(sinks: Any, told: str) -> None:  # noqa: ANN401 - what JSON may hold
    text = missing_rows({"sinks": sinks}, [*PARTS, SLIPS])
    assert bool(text) == bool(told)
    assert text.startswith(told)


def test_parts_are_missed_by_their_numbers_in_each_table() -> None:
    paths = ["touch/part-000002.parquet", "motion/part-000001.parquet", "motion/part-000000.parquet"]
    assert missing_parts(paths) == ["touch/part-000000.parquet", "touch/part-000001.parquet"]
    assert missing_parts([]) == []


def test_segments_are_missed_between_others_and_where_there_is_none(tmp_path: Path) -> None:
    assert missing_segments(tmp_path, {}) == []
    (tmp_path / "journal").mkdir()
    assert "has no segment" in missing_segments(tmp_path, {})[0]
    assert missing_segments(tmp_path, {"end_ns": 5}) == []
    for number in (4, 7):
        (tmp_path / segment_file(number)).touch()
    gone = [f"journal/{name}.wal: is missing, with its rows" for name in ("000005", "000006", "single")]
    assert missing_segments(tmp_path, {}) == gone
    assert missing_segments(tmp_path, {"end_ns": 5}) == gone[:2]
