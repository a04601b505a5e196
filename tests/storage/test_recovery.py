import asyncio
import errno
import os
from pathlib import Path
from typing import Any, cast

import pytest

from operators.errors import EndpointError, InputError
from storage import Dataset, Session, files, recover, recovery, verify
from storage.description import read_session
from storage.lock import lock
from storage.manifest import read_manifest
from tests.storage.disk_steps import observed
from tests.storage.made import leave, new_run, rows, side_by_side

BATCHES = side_by_side(5)
RECOVERED: dict[str, Any] = {
    "rows": {"touch": 10, "motion": 5, "samples": 5, "slips": 25},
    "adopted": [],
    "lost": [],
    "cut": [],
}


@pytest.fixture
def left(tmp_path: Path) -> Path:
    return leave(tmp_path / "data", new_run(), BATCHES)


def test_rows_of_the_journal_become_listed_parts(left: Path) -> None:
    done = recover(left)
    assert done.rows == RECOVERED["rows"]
    assert (done.adopted, done.lost, done.complete) == ((), (), True)
    assert rows(left, BATCHES) == [25] * 5
    assert {path.relative_to(left).as_posix() for path in left.rglob("*.parquet")} == set(read_manifest(left))
    assert not (left / "journal").exists()
    about: Any = Session.open(left).about
    assert (about["complete"], about["error"]) == (False, "was not closed")
    assert about["end_ns"] == int(BATCHES[-1].time[-1])
    assert about["recovered"]["rows"] == dict(done.rows)


def test_a_second_recovery_finds_nothing_to_do_and_changes_nothing(left: Path) -> None:
    assert recover(left).changed
    before = {path: path.read_bytes() for path in left.rglob("*") if path.is_file()}
    assert not recover(left).changed
    assert {path: path.read_bytes() for path in left.rglob("*") if path.is_file()} == before


async def test_a_session_that_was_closed_needs_nothing(tmp_path: Path) -> None:
    dataset = Dataset(tmp_path)
    await dataset.open(new_run())
    for batch in BATCHES:
        await dataset.write(cast("Any", batch))
    await dataset.close()
    folder = tmp_path / "sessions/one"
    before = (folder / "session.json").read_bytes()
    assert not recover(folder).changed
    assert (folder / "session.json").read_bytes() == before
    assert Session.open(folder).about["complete"] is True


def test_a_session_that_is_being_recorded_is_left_alone(left: Path) -> None:
    held = lock(left)
    assert held is not None
    with pytest.raises(EndpointError, match="one: is being recorded"):
        recover(left)
    assert rows(left, BATCHES) == [20, 20, 20, 20, 0]


def test_a_complete_recovery_is_repaired(left: Path) -> None:
    assert (verify(left).code, verify(left).worst) == (3, "repairable")
    recover(left)
    assert (verify(left).code, verify(left).worst) == (3, "repaired")


def test_a_journal_of_another_slipflow_is_refused_and_nothing_is_changed(
    left: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {path: path.read_bytes() for path in left.rglob("*") if path.is_file()}
    monkeypatch.setattr("storage.journal.VERSION", 7)
    with pytest.raises(InputError, match=r"\.wal: has version 5; this slipflow reads version 7"):
        recover(left)
    assert {path: path.read_bytes() for path in left.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    "wrong", [{"recovered": []}, {"recovered": {"lost": 1}}, {"recovered": {"rows": []}}, {"tables": [1]}]
)
def test_an_invalid_description_is_refused(left: Path, wrong: dict[str, Any]) -> None:
    about = files.read_checked(left / "session.json")
    files.put_checked(left / "session.json", {**about, **wrong})
    with pytest.raises(InputError, match=r'session\.json: has an invalid entry "tables" or "recovered"'):
        recover(left)
    assert verify(left).worst == "lost"


def test_a_disk_that_is_full_leaves_all_as_it_was_for_another_try(left: Path) -> None:
    def fail(step: str) -> None:
        if step == "fsync new manifest":
            raise OSError(28, "No space left on device")

    with observed(fail), pytest.raises(EndpointError, match="cannot be recovered: No space left on device"):
        recover(left)
    done = recover(left)
    assert done.rows["touch"] == 10
    assert rows(left, BATCHES) == [25] * 5


@pytest.mark.parametrize("error", [errno.EIO, errno.EMFILE, errno.ENOMEM])
@pytest.mark.parametrize("name", ["touch/part-000001.parquet", "journal/000001.wal", "MANIFEST.json"])
def test_a_file_that_cannot_be_read_is_not_damaged_and_stays(
    left: Path, monkeypatch: pytest.MonkeyPatch, error: int, name: str
) -> None:
    def fail(path: Path, **named: bool) -> int:
        if path == left / name:
            raise OSError(error, os.strerror(error))
        return real(path, **named)

    real = files.open_file
    with monkeypatch.context() as patch:
        patch.setattr(files, "open_file", fail)
        with pytest.raises(EndpointError, match=os.strerror(error)):
            verify(left)
    if name != "MANIFEST.json":
        (left / "MANIFEST.json").unlink()  # so that all parts are read
    before = {path: path.read_bytes() for path in left.rglob("*") if path.is_file()}
    with monkeypatch.context() as patch:
        patch.setattr(files, "open_file", fail)
        with pytest.raises(EndpointError, match=os.strerror(error)):
            recover(left)
    assert {path: path.read_bytes() for path in left.rglob("*") if path.is_file()} == before
    assert recover(left).complete


def test_two_that_recover_at_once_both_see_all(left: Path) -> None:
    async def both() -> list[list[int]]:
        return await asyncio.gather(*(asyncio.to_thread(rows, left, BATCHES) for _ in range(4)))

    assert asyncio.run(both()) == [[25] * 5] * 4


def test_a_recovery_that_waited_for_another_reports_no_loss(
    left: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_then_wait(folder: Path) -> Any:  # noqa: ANN401 - as the function that it replaces
        about = read_session(folder)
        monkeypatch.setattr(recovery, "read_session", read_session)
        recover(folder)
        return about

    monkeypatch.setattr(recovery, "read_session", read_then_wait)
    assert not recover(left).changed
    assert (Session.open(left).about["recovered"], verify(left).worst) == (RECOVERED, "repaired")
