import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from operators import Clocks
from storage import journal_segment
from storage.journal_segment import NumberedRows, OpenSegment, Segment, read_segment
from tests.storage.made import new_batch


def read(path: Path) -> Segment:
    return read_segment(path.read_bytes(), str(path), "one", 0)


def body(number: int, rows: int = 1) -> bytes:
    [data] = journal_segment.bodies([NumberedRows(number, new_batch(Clocks, rows))])
    return data


def told(segment: Segment) -> list[int]:
    return [rows.first for rows in segment.rows]


def test_frames_are_there_in_order_as_soon_as_they_are_appended(tmp_path: Path) -> None:
    segment = OpenSegment(tmp_path / "000000.wal", "one", 0)
    for number in range(3):
        segment.append([body(10 * number), body(10 * number + 1)])
        assert told(read(segment.path))[-2:] == [10 * number, 10 * number + 1]
        assert read(segment.path).damage is None
    segment.sync()
    segment.close()
    segment.close()


@pytest.mark.parametrize("part", [0, 1, 29, 45])
def test_a_partial_append_is_undone_and_can_be_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: int
) -> None:
    pwrite = os.pwrite

    def full(file: int, data: memoryview, place: int) -> int:
        if not part or place > size:
            raise OSError(28, "No space left on device")
        return pwrite(file, data[:part], place)

    segment = OpenSegment(tmp_path / "000000.wal", "one", 0)
    segment.append([body(1)])
    before = segment.path.read_bytes()
    size = len(before)
    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        with pytest.raises(OSError, match="No space left"):
            segment.append([body(2), body(3)])
    assert segment.path.read_bytes() == before
    segment.append([body(2), body(3)])
    assert told(read(segment.path)) == [1, 2, 3]
    segment.close()


def test_where_it_cannot_be_taken_back_the_next_frames_are_written_over_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pwrite = os.pwrite

    def full(file: int, data: memoryview, place: int) -> int:
        pwrite(file, data[: len(data) - 1], place)
        raise OSError(28, "No space left on device")

    def fail(*_: int) -> None:
        raise OSError(5, "Input/output error")

    segment = OpenSegment(tmp_path / "000000.wal", "one", 0)
    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        patch.setattr(os, "ftruncate", fail)
        with pytest.raises(OSError, match="No space left"):
            segment.append([body(n) for n in range(9)])
    segment.append([body(99, 2)])
    found = read(segment.path)
    assert told(found) == [99]
    assert found.damage is not None
    segment.close()


def test_a_file_that_may_not_grow_keeps_whole_frames_only(tmp_path: Path) -> None:
    """The kernel's own limit, which writes what still fits and then fails."""
    code = f"""
import resource, signal
from pathlib import Path
from operators import Clocks
from storage import journal_segment
from storage.journal_segment import OpenSegment
from tests.storage.made import new_batch
signal.signal({signal.SIGXFSZ.value}, signal.SIG_IGN)
segment, took = OpenSegment(Path({str(tmp_path / "000000.wal")!r}), "one", 0), 0
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    while True:
        segment.append(journal_segment.bodies([journal_segment.NumberedRows(took, new_batch(Clocks, 1))]))
        took += 1
except OSError as error:
    print(took, error.strerror)
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[2],
    )
    took, reason = done.stdout.strip().split(" ", 1)
    found = read(tmp_path / "000000.wal")
    assert (told(found), found.damage, reason) == ([*range(int(took))], None, "File too large")


def test_only_new_frames_are_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    segment, synced = OpenSegment(tmp_path / "000000.wal", "one", 0), list[int]()
    monkeypatch.setattr(os, "fsync", synced.append)
    segment.sync()
    assert synced == []
    segment.append([body(1)])
    segment.sync()
    segment.sync()
    assert len(synced) == 1
    segment.close()


def test_it_may_begin_with_frames_in_place_of_another(tmp_path: Path) -> None:
    path = tmp_path / "000000.wal"
    for number in range(2):
        segment = OpenSegment(path, "one", 0, [body(10 * number), body(10 * number + 1)])
        segment.append([body(99, 2)])
        segment.close()
        assert told(read(path)) == [10 * number, 10 * number + 1, 99]
    assert [each.name for each in tmp_path.iterdir()] == [path.name]
