from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.batch import Slips, Touch, concat, packed_type
from operators.errors import InputError
from operators.fingertip import CELL_LIMIT
from storage import journal
from storage.append_log import LIMIT, AppendLog, LogReader
from storage.journal import Buffer, Journal, NumberedRows, check_segment, decode
from storage.layout import SEGMENTS, numbered_files
from tests.storage.made import new_batch, new_episodes, same


@pytest.fixture
def written(tmp_path: Path) -> Iterator[Journal]:
    made = Journal(tmp_path, "one")
    yield made
    made.close()


def rows(path: Path, number: int) -> list[NumberedRows]:
    reader = LogReader(path)
    check_segment(reader, "one", number)
    found = [decode(record.data, str(path)) for record in reader.records()]
    assert reader.damage is None
    return found


def found(folder: Path) -> list[tuple[str, int, int]]:
    """Type, first row and rows of each record."""
    return [
        (type(each.batch).__name__, each.first, len(each.batch))
        for number, path in numbered_files(folder, SEGMENTS).items()
        for each in rows(path, number)
    ]


def test_a_segment_is_deleted_when_the_commit_after_its_last_row_is_complete_and_keeps_all_single_rows(
    written: Journal, tmp_path: Path
) -> None:
    slips = NumberedRows(0, new_batch(Slips, 2))
    written.append(slips)
    for number in range(4):
        written.append(NumberedRows(2 * number, new_batch(Touch, 1)))
        written.begin_commit()
        written.append(NumberedRows(2 * number + 1, new_batch(Touch, 1)))  # not committed
        written.rotate([slips])
        assert list(numbered_files(tmp_path, SEGMENTS)) == [number, number + 1]
    assert found(tmp_path) == [("Slips", 0, 2), ("Touch", 6, 1), ("Touch", 7, 1), ("Slips", 0, 2)]


def test_a_batch_that_a_buffer_cannot_take_changes_nothing_in_it() -> None:
    buffer, good = Buffer(Slips), new_batch(Slips, 2, finger=1)
    buffer.add(good)
    with pytest.raises(OverflowError):
        buffer.add(new_batch(Slips, 3, finger=2**15))
    buffer.add(good)
    assert [(each.first, each.batch.finger, len(each.batch)) for each in buffer.numbered()] == [(0, 1, 4)]


def test_a_batch_of_more_than_64_mib_is_appended_in_several_records(written: Journal, tmp_path: Path) -> None:
    rows = LIMIT // packed_type(Touch, CELL_LIMIT).itemsize + 1
    batch = Touch.zeros(rows, CELL_LIMIT)
    batch.time[:] = np.arange(rows)
    written.append(NumberedRows(7, batch))
    [(number, path)] = numbered_files(tmp_path, SEGMENTS).items()
    found = [decode(record.data, str(path)) for record in LogReader(path).records()]
    assert (number, [each.first for each in found]) == (0, [7, 7 + len(found[0].batch)])
    same(concat(Touch, [each.batch for each in found]), batch)


def test_a_code_without_a_name_and_a_row_without_a_cell_are_an_input_error() -> None:
    unnamed = new_episodes((0, 9, "hold"))
    unnamed.motion[:] = 9
    for batch in (unnamed, Touch.zeros(1, 0)):
        [record] = journal.encode([NumberedRows(0, batch)])
        with pytest.raises(InputError, match="has an invalid record"):
            decode(record, "a.wal")


@given(records=st.lists(st.binary(max_size=80)), identity=st.none() | st.binary())
def test_any_content_of_a_log_is_rows_or_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, records: list[bytes], identity: bytes | None
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.wal"
    own = journal.identity("one", 0) if identity is None else identity
    AppendLog(path, own, records).close()
    with suppress(InputError):
        assert all(isinstance(each, NumberedRows) for each in rows(path, 0))
