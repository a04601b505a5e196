import json
from pathlib import Path
from shutil import copytree, rmtree

import pytest

from operators.errors import InputError
from storage import Session, verify
from storage.manifest import read_manifest
from tests.storage.made import leave, new_run, side_by_side, two_sessions

BATCHES = side_by_side(5)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return two_sessions(tmp_path_factory.mktemp("whole"), BATCHES)


@pytest.fixture
def dataset(whole: Path, tmp_path: Path) -> Path:
    copytree(whole, tmp_path / "data")
    return tmp_path / "data"


def test_a_dataset_that_is_all_there_is_good_and_its_rows_are_counted(dataset: Path) -> None:
    reported: list[tuple[int, int, str]] = []

    def report(done: int, of: int, session: str) -> None:
        reported.append((done, of, session))

    found = verify(dataset, report)
    assert (found.code, found.findings, found.sessions) == (0, (), 2)
    assert (found.files, found.rows) == (11 + 4, 126 + 25)
    assert reported[-1] == (15, 15, "two")
    assert verify(dataset / "sessions/two").rows == 25


def test_a_flipped_bit_in_any_listed_file_or_the_manifest_is_found(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "one"
    copytree(whole / "sessions/one", folder)
    listed = read_manifest(folder)
    for path in [folder / "MANIFEST.json", *sorted(folder.rglob("*.parquet"))]:
        data = path.read_bytes()
        for seed in range(6):
            flipped = bytearray(data)
            flipped[(seed * 7919 + 31) % len(data)] ^= 1 << seed
            path.write_bytes(flipped)
            found = verify(folder)
            assert found.code == 1 or read_manifest(folder) == listed
            if found.code:
                assert path.name in found.findings[0].text
        path.write_bytes(data)


@pytest.mark.parametrize("left", ["MANIFEST.json", "touch/part-000000.parquet", "journal/000000.wal"])
def test_a_session_that_lost_its_description_is_lost(dataset: Path, left: str) -> None:
    rmtree(dataset / "sessions/one")
    place = dataset / "sessions/one" / left
    place.parent.mkdir(parents=True)
    place.write_bytes(b"{}")
    for path, sessions in ((dataset, 2), (dataset / "sessions/one", 1)):
        found = verify(path)
        assert (found.code, found.sessions) == (1, sessions)
        assert any("its session.json is missing" in each.text for each in found.findings)


def test_a_dataset_without_sessions_is_not_all_there(dataset: Path) -> None:
    rmtree(dataset / "sessions")
    found = verify(dataset)
    assert (found.code, found.sessions) == (3, 0)
    assert "has no session" in found.findings[0].text


def test_a_folder_that_is_not_a_dataset_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(InputError, match=r"no such folder|is not a session"):
            verify(path)


def test_verifying_changes_nothing(tmp_path: Path) -> None:
    leave(tmp_path, new_run(), BATCHES)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    verify(tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert json.loads((tmp_path / "sessions/one/session.json").read_text())["complete"] is False
    assert len(Session.open(tmp_path).frame("touch")) == 50
