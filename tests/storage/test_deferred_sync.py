import os
from pathlib import Path

import pytest

from storage.files import DeferredSync
from tests.storage.disk_steps import observed


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The names of what was made durable."""
    found, fsync = set[str](), os.fsync

    def note(number: int) -> None:
        found.add(Path(f"/proc/self/fd/{number}").readlink().name)
        fsync(number)

    monkeypatch.setattr(os, "fsync", note)
    return found


@pytest.fixture
def deferred(tmp_path: Path) -> DeferredSync:
    made = DeferredSync()
    made.make_folder(tmp_path / "touch", new=True)
    for name in ("touch/part-000000.parquet", "MANIFEST.json", "MANIFEST.json"):
        made.put(tmp_path / name, name.encode())
    return made


def test_files_are_in_place_at_once_and_durable_after_settle(
    deferred: DeferredSync, tmp_path: Path, synced: set[str]
) -> None:
    assert (tmp_path / "MANIFEST.json").read_bytes() == b"MANIFEST.json"
    assert synced == set()
    deferred.settle()
    assert synced == {"part-000000.parquet", "MANIFEST.json", "touch", tmp_path.name}
    synced.clear()
    deferred.settle()
    assert synced == set()


def test_all_files_are_durable_before_any_folder_is_asked_for(
    deferred: DeferredSync, synced: set[str], tmp_path: Path
) -> None:
    before = list[set[str]]()

    def note(step: str) -> None:
        if step == f"fsync {tmp_path.name}":
            before.append(set(synced))

    with observed(note):
        deferred.settle()
    assert before == [{"part-000000.parquet", "MANIFEST.json"}]


def test_after_a_failed_fsync_files_are_written_again(
    deferred: DeferredSync, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = tmp_path / "touch/part-000000.parquet"
    before = part.stat().st_ino

    def fail(_: int) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail)
        with pytest.raises(OSError, match="Input/output"):
            deferred.settle()
    assert part.stat().st_ino == before
    deferred.settle()
    assert part.read_bytes() == b"touch/part-000000.parquet"
    assert part.stat().st_ino != before


def test_content_that_the_disk_lost_is_an_error(
    deferred: DeferredSync, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail)
        with pytest.raises(OSError, match="Input/output"):
            deferred.settle()
    (tmp_path / "MANIFEST.json").write_bytes(b"anything")
    for _ in range(2):
        with pytest.raises(OSError, match="the disk has lost what was written"):
            deferred.settle()


def test_a_folder_that_has_to_be_new_is_refused_if_it_is_there(
    deferred: DeferredSync, tmp_path: Path
) -> None:
    deferred.make_folder(tmp_path / "touch")
    with pytest.raises(FileExistsError):
        deferred.make_folder(tmp_path / "touch", new=True)
