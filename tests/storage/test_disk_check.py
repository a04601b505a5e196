import errno
import os
from pathlib import Path

import pytest

from operators.errors import EndpointError
from storage import files
from storage.files import check_disk


def test_space_and_fsync_of_the_disk_are_measured_without_leaving_a_file(tmp_path: Path) -> None:
    space, sync = check_disk(tmp_path / "new" / "recordings")
    assert space.text.endswith(" GB free")
    assert sync.text.startswith("fsync ")
    assert list(tmp_path.iterdir()) == []


def test_a_full_and_slow_disk_is_bad(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "FREE_MIN", 1e18)
    monkeypatch.setattr(files, "SYNC_MAX", 0.0)
    space, sync = check_disk(tmp_path)
    assert (space.state, sync.state) == ("bad", "bad")
    assert space.text.endswith(": free some space, or use another disk")


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(EndpointError, match="cannot be written: Read-only file system; use a writable"):
        check_disk(tmp_path)
