import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.errors import InputError
from storage.layout import GAP_MAX, MOTION
from storage.manifest import (
    Part,
    missing_parts,
    missing_rows,
    read_manifest,
    write_manifest,
)

GOOD: dict[str, Any] = {
    "path": "touch/part-000000.parquet",
    "rows": 3,
    "first": 1,
    "last": 5,
    "sha256": "0f" * 32,
}

times = st.integers(-(2**63), 2**63 - 1)


@st.composite
def parts(draw: st.DrawFn) -> Part:
    path = MOTION.file(draw(st.integers(0, 10_000_000)))
    first, last = sorted([draw(times), draw(times)])
    return Part(
        path, draw(st.integers(1, 2**40)), first, last, draw(st.binary(min_size=32, max_size=32)).hex()
    )


@settings(deadline=None)
@given(listed=st.lists(parts(), unique_by=lambda part: part.path))
def test_a_manifest_comes_back_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, listed: list[Part]
) -> None:
    folder = tmp_path_factory.getbasetemp()
    write_manifest(folder, listed)
    assert list(read_manifest(folder).values()) == listed


def test_a_table_of_one_file_may_be_without_rows(tmp_path: Path) -> None:
    nothing = Part("slips.parquet", 0, 0, 0, "0f" * 32)
    write_manifest(tmp_path, [nothing])
    assert read_manifest(tmp_path) == {"slips.parquet": nothing}


def test_a_session_without_a_manifest_lists_nothing(tmp_path: Path) -> None:
    assert read_manifest(tmp_path) == {}


@pytest.mark.parametrize(
    "part",
    [
        None,
        [],
        "part",
        {},
        {**GOOD, "more": 1},
        {**GOOD, "rows": 3.0},
        {**GOOD, "rows": True},
        {**GOOD, "rows": 0},
        {**GOOD, "rows": 0, "first": 0, "last": 0},
        {**GOOD, "path": "slips.parquet", "rows": 0},
        {**GOOD, "first": 6},
        {**GOOD, "sha256": "0f"},
        {**GOOD, "sha256": "0F" * 32},
        {**GOOD, "path": "../touch/part-000000.parquet"},
        {**GOOD, "path": "/etc/passwd"},
        {**GOOD, "path": "touch/part-000000.parquet\n"},
        {**GOOD, "path": "touch/../motion/part-000000.parquet"},
        {**GOOD, "path": 7},
    ],
)
def test_a_part_that_cannot_be_is_refused_by_its_number(tmp_path: Path, part: object) -> None:
    (tmp_path / "MANIFEST.json").write_text(json.dumps({"version": 2, "parts": [GOOD, part]}))
    with pytest.raises(InputError, match=r"MANIFEST\.json, part 1: "):
        read_manifest(tmp_path)


@pytest.mark.parametrize("content", [{}, {"version": 1, "parts": []}, {"version": 2, "parts": {}}])
def test_another_version_or_no_list_is_refused(tmp_path: Path, content: object) -> None:
    (tmp_path / "MANIFEST.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"MANIFEST\.json: must have"):
        read_manifest(tmp_path)


def test_a_part_listed_twice_is_refused(tmp_path: Path) -> None:
    (tmp_path / "MANIFEST.json").write_text(json.dumps({"version": 2, "parts": [GOOD, GOOD]}))
    with pytest.raises(InputError, match="twice"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("bit", range(8))
def test_a_flipped_bit_anywhere_is_reported_or_changes_nothing(tmp_path: Path, bit: int) -> None:
    listed = [Part(f"touch/part-{n:06d}.parquet", n + 1, n, 10 + n, f"{n:064x}") for n in range(2)]
    write_manifest(tmp_path, listed)
    data = (tmp_path / "MANIFEST.json").read_bytes()
    reported = 0
    for place in range(len(data)):
        flipped = bytearray(data)
        flipped[place] ^= 1 << bit
        (tmp_path / "MANIFEST.json").write_bytes(flipped)
        try:
            assert list(read_manifest(tmp_path).values()) == listed
        except InputError:
            reported += 1
    assert reported > 0.9 * len(data)


PARTS = [Part(f"touch/part-{number:06d}.parquet", 10, 0, 9, "0" * 64) for number in range(3)]
SLIPS = Part("slips.parquet", 5, 0, 9, "0" * 64)


@pytest.mark.parametrize(
    ("sinks", "report"),
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
def test_rows_that_no_part_holds_are_counted(sinks: Any, report: str) -> None:  # noqa: ANN401 - what JSON may hold
    text = missing_rows({"sinks": sinks}, [*PARTS, SLIPS])
    assert bool(text) == bool(report)
    assert text.startswith(report)


def test_parts_are_missed_by_their_numbers_in_each_table() -> None:
    paths = ["touch/part-000002.parquet", "motion/part-000001.parquet", "motion/part-000000.parquet"]
    assert missing_parts(paths) == ["touch/part-000000.parquet", "touch/part-000001.parquet"]
    assert missing_parts([]) == []


def test_a_long_gap_between_parts_is_one_line() -> None:
    gap = "touch/part-000001.parquet to touch/part-999999999998.parquet"
    assert missing_parts(["touch/part-999999999999.parquet", "touch/part-000000.parquet"]) == [gap]
    assert len(missing_parts([f"touch/part-{GAP_MAX:06d}.parquet"])) == GAP_MAX
    assert len(missing_parts([f"touch/part-{GAP_MAX + 1:06d}.parquet"])) == 1


def test_a_part_with_a_number_of_any_length_is_refused(tmp_path: Path) -> None:
    write_manifest(tmp_path, [replace(PARTS[0], path=f"touch/part-{'9' * 5000}.parquet")])
    with pytest.raises(InputError, match="is not a file of a session"):
        read_manifest(tmp_path)
