import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from operators.batch import Batch, Motion, Slips, Touch
from storage import journal_segment, steps
from storage.journal import APPEND_AT, MAX_WAITING, Journal
from storage.journal_segment import NumberedRows, read_segment
from storage.layout import segments, single_log
from tests.storage.made import new_batch


class Steps:
    """Tells when the journal has done something, and can hold or fail what it does."""

    def __init__(self) -> None:
        self.reached = threading.Semaphore(0)
        self.go_on = threading.Event()
        self.go_on.set()
        self.failing = False

    def __call__(self, step: str) -> None:
        if step == "append frames":
            self.reached.release()
            assert self.go_on.wait(60)
            if self.failing:
                raise OSError(28, "No space left on device")

    def wait(self) -> None:
        """Until it appends next."""
        assert self.reached.acquire(timeout=60)


@pytest.fixture
def step(monkeypatch: pytest.MonkeyPatch) -> Steps:
    found = Steps()
    monkeypatch.setattr(steps, "reach", found)
    return found


@pytest.fixture
def journal(tmp_path: Path, step: Steps) -> Iterator[Journal]:
    made = Journal(tmp_path, "one")
    yield made
    step.go_on.set()
    step.failing = False
    made.leave()


def singles(folder: Path) -> list[tuple[int, int]]:
    """First row and rows of each frame of a single-file table."""
    segment = read_segment(single_log(folder).read_bytes(), "", "one", journal_segment.SINGLE_LOG)
    return [(rows.first, len(rows.batch)) for rows in segment.rows]


def found(folder: Path) -> list[tuple[str, int, int]]:
    """Type, first row and rows of each frame."""
    return [
        (type(rows.batch).__name__, rows.first, len(rows.batch))
        for number, path in segments(folder).items()
        for rows in read_segment(path.read_bytes(), str(path), "one", number).rows
    ]


def test_added_rows_are_appended_in_the_background(journal: Journal, step: Steps, tmp_path: Path) -> None:
    assert journal.add(NumberedRows(0, new_batch(Touch, 1)))
    step.wait()
    with journal.held():
        assert found(tmp_path) == [("Touch", 0, 1)]


def test_rows_that_wait_are_appended_at_once_when_there_are_some(
    tmp_path: Path, step: Steps, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("storage.journal.APPEND_INTERVAL", 3600.0)
    journal = Journal(tmp_path, "one")
    for number in range(APPEND_AT):
        assert journal.add(NumberedRows(number, new_batch(Touch, 1)))
    step.wait()
    with journal.held():
        assert found(tmp_path) == [("Touch", 0, APPEND_AT)]
    journal.leave()


def test_no_more_than_ten_rows_of_a_table_wait_for_a_stuck_disk(journal: Journal, step: Steps) -> None:
    step.go_on.clear()
    took = [journal.add(NumberedRows(number, new_batch(Touch, 1))) for number in range(2 * MAX_WAITING)]
    assert took == [True] * MAX_WAITING + [False] * MAX_WAITING
    assert journal.add(NumberedRows(0, new_batch(Motion, MAX_WAITING)))
    assert not journal.add(NumberedRows(0, new_batch(Slips, MAX_WAITING + 1)))


def test_rows_beyond_the_limit_wait_for_earlier_ones(journal: Journal, step: Steps, tmp_path: Path) -> None:
    step.go_on.clear()
    assert journal.add(NumberedRows(0, new_batch(Touch, MAX_WAITING)))
    step.wait()
    waiter = threading.Thread(target=journal.append, args=[NumberedRows(MAX_WAITING, new_batch(Touch, 100))])
    waiter.start()
    assert found(tmp_path) == []
    step.go_on.set()
    waiter.join(60)
    assert found(tmp_path) == [("Touch", 0, MAX_WAITING), ("Touch", MAX_WAITING, 100)]
    assert journal.add(NumberedRows(110, new_batch(Touch, MAX_WAITING)))


def test_a_full_disk_refuses_rows_until_there_is_room_and_loses_and_repeats_none(
    journal: Journal, step: Steps, tmp_path: Path
) -> None:
    step.failing = True
    assert journal.add(NumberedRows(0, new_batch(Touch, APPEND_AT)))
    step.wait()
    for _ in range(3):
        with pytest.raises(OSError, match="No space left"):
            journal.append(NumberedRows(APPEND_AT, new_batch(Touch, 1)))
        assert not journal.add(NumberedRows(APPEND_AT, new_batch(Touch, 1)))
    step.failing = False
    journal.append(NumberedRows(APPEND_AT, new_batch(Touch, 2)))
    assert found(tmp_path) == [("Touch", 0, APPEND_AT + 2)]
    assert journal.add(NumberedRows(APPEND_AT + 2, new_batch(Touch, 1)))


def test_a_new_segment_begins_with_the_rows_that_stay_and_the_old_goes_when_it_may(
    journal: Journal, tmp_path: Path
) -> None:
    kept = [NumberedRows(3, new_batch(Slips, 2))]
    journal.append(NumberedRows(0, new_batch(Touch, 4)), *kept)
    journal.rotate(lambda: kept, list)
    assert list(segments(tmp_path)) == [0, 1]
    journal.append(NumberedRows(4, new_batch(Touch, 1)))
    journal.drop()
    assert list(segments(tmp_path)) == [1]
    assert found(tmp_path) == [("Slips", 3, 2), ("Touch", 4, 1)]


def test_rows_that_wait_while_a_new_segment_is_begun_are_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("storage.journal.APPEND_INTERVAL", 3600.0)
    journal, touch = Journal(tmp_path, "one"), [new_batch(Touch, 1) for _ in range(3)]
    for number in range(3):
        assert journal.add(NumberedRows(number, touch[number]))
    journal.rotate(
        lambda: [NumberedRows(2, touch[2])], list
    )  # the others are to be committed, and may not be yet
    assert found(tmp_path) == [("Touch", 0, 3), ("Touch", 2, 1)]
    assert journal.add(NumberedRows(3, touch[0]))
    journal.rotate(
        lambda: [NumberedRows(2, new_batch(Touch, 2))], list
    )  # one of them is in the segment before
    journal.drop()
    assert found(tmp_path) == [("Touch", 2, 2), ("Touch", 3, 1)]
    journal.leave()


def test_a_segment_that_cannot_be_begun_leaves_the_old_one_in_use(
    journal: Journal, step: Steps, tmp_path: Path
) -> None:
    journal.append(NumberedRows(0, new_batch(Touch, 1)))
    step.failing = True
    with pytest.raises(OSError, match="No space left"):
        journal.rotate(lambda: [NumberedRows(0, new_batch(Touch, 1))], list)
    step.failing = False
    journal.append(NumberedRows(1, new_batch(Touch, 1)))
    assert found(tmp_path) == [("Touch", 0, 1), ("Touch", 1, 1)]
    journal.rotate(list, list)
    journal.drop()
    assert found(tmp_path) == []


def test_a_slow_fsync_does_not_delay_appends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    syncing, go_on, fsync = threading.Event(), threading.Event(), os.fsync

    def slow(file: int) -> None:
        if threading.current_thread() is not threading.main_thread():
            syncing.set()
            assert go_on.wait(60)
        fsync(file)

    monkeypatch.setattr("storage.journal.SYNC_INTERVAL", 0.001)
    monkeypatch.setattr(os, "fsync", slow)
    journal = Journal(tmp_path, "one")
    journal.append(NumberedRows(0, new_batch(Touch, 1)))
    assert syncing.wait(60)
    for number in range(1, 50):
        journal.append(NumberedRows(number, new_batch(Touch, 1)))
    assert len(found(tmp_path)) == 50
    go_on.set()
    journal.leave()


def test_an_fsync_that_fails_is_remembered_until_there_is_a_new_segment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed = threading.Event()

    def fail(_: int) -> None:
        failed.set()
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("storage.journal.SYNC_INTERVAL", 0.001)
    journal = Journal(tmp_path, "one")
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail)
        journal.append(NumberedRows(0, new_batch(Touch, 1)))
        assert failed.wait(60)
        journal.stop()
    suspect = [journal.suspect]
    journal.rotate(list, list)
    assert [*suspect, journal.suspect] == [True, False]
    journal.leave()


def test_its_threads_end_with_it_and_waiting_rows_are_written(tmp_path: Path) -> None:
    before = threading.active_count()
    journal, batch = Journal(tmp_path, "one"), list[Batch]([new_batch(Touch, 1)])
    assert threading.active_count() == before + 2
    assert journal.add(NumberedRows(0, batch[0]))
    journal.leave()
    assert threading.active_count() == before
    assert found(tmp_path) == [("Touch", 0, 1)]
    journal.remove()
    assert list(tmp_path.iterdir()) == []


def test_rows_of_a_table_of_one_file_are_appended_once_and_outlive_the_segments(
    journal: Journal, tmp_path: Path
) -> None:
    def refuse() -> list[NumberedRows]:
        raise AssertionError

    for number in range(3):
        journal.append(NumberedRows(2 * number, new_batch(Slips, 2)))
        journal.rotate(list, refuse)
        journal.drop()
    assert singles(tmp_path) == [(0, 2), (2, 2), (4, 2)]
    assert found(tmp_path) == []


def test_after_a_failed_fsync_rows_are_written_again_from_memory(
    journal: Journal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise OSError(5, "Input/output error")

    slips = new_batch(Slips, 4)
    journal.append(NumberedRows(0, slips))
    before = single_log(tmp_path).stat().st_ino
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail)
        with pytest.raises(OSError, match="Input/output"):
            journal.sync()
    suspect = [journal.suspect]
    journal.rotate(list, lambda: [NumberedRows(0, slips)])
    assert [*suspect, journal.suspect] == [True, False]
    assert singles(tmp_path) == [(0, 4)]
    assert single_log(tmp_path).stat().st_ino != before


def test_rows_that_cannot_be_appended_to_both_are_in_neither(
    journal: Journal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(step: str) -> None:
        if step == "append frames":
            raise OSError(28, "No space left on device")

    with journal.held():
        assert journal.add(NumberedRows(0, new_batch(Touch, 1)))
        with monkeypatch.context() as patch:
            patch.setattr(steps, "reach", fail)
            with pytest.raises(OSError, match="No space left"):
                journal.append(NumberedRows(0, new_batch(Slips, 1)))
        assert singles(tmp_path) == []
        journal.append(NumberedRows(0, new_batch(Slips, 3)))
    assert singles(tmp_path) == [(0, 3)]
    assert found(tmp_path) == [("Touch", 0, 1)]
