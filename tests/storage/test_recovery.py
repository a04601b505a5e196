"""What a recovery restores, keeps and reports; `tests.faults` kills recorders and cuts the power."""

import asyncio
import errno
import json
import os
from pathlib import Path
from shutil import copyfile, rmtree
from typing import Any

import pytest

from operators.batch import Touch
from operators.errors import EndpointError, InputError
from storage import Session, files, recover, verify
from storage.append_log import AppendLog
from storage.journal import NumberedRows, encode, identity
from storage.layout import SEGMENTS, numbered_files
from storage.parts import read_manifest, write_manifest
from tests.storage.made import contents, flip, leave, new_run, rows, side_by_side, write

BATCHES = side_by_side(5)
ALL = [25] * 5
RECOVERED: dict[str, Any] = {
    "rows": {"touch": 10, "motion": 5, "samples": 5, "slips": 25},
    "lost": [],
    "cut": [],
}


@pytest.fixture
def left(tmp_path: Path) -> Path:
    """Session of a killed recorder: two parts of each table, and the newest rows in the journal."""
    return leave(tmp_path / "data", new_run(), BATCHES)


def recovered(folder: Path) -> Any:
    return Session.open(folder).about["recovered"]


def test_rows_of_the_journal_become_listed_parts_once(left: Path) -> None:
    assert (verify(left).code, verify(left).worst) == (3, "repairable")
    done = recover(left)
    assert (done.rows, done.lost) == (RECOVERED["rows"], [])
    assert rows(left, BATCHES) == ALL
    assert {path.relative_to(left).as_posix() for path in left.rglob("*.parquet")} == set(read_manifest(left))
    assert not (left / "journal").exists()
    about: Any = Session.open(left).about
    assert (about["complete"], about["error"], about["recovered"]) == (False, "was not closed", RECOVERED)
    assert about["end_ns"] == int(BATCHES[-1].time[-1])
    assert (verify(left).code, verify(left).worst) == (3, "repaired")
    (left / "journal").mkdir()
    before = contents(left)
    assert Session.open(left).about == about
    assert (left / "journal").exists()  # opening it has recovered nothing
    assert not recover(left).changed
    assert contents(left) == before


def test_a_recorder_killed_after_its_last_commit_has_lost_no_known_row(tmp_path: Path) -> None:
    write(tmp_path, new_run(), [each for each in BATCHES if type(each) is Touch]).commit()
    assert recover(tmp_path / "sessions/one").lost == []
    assert verify(tmp_path).worst == "repaired"


def test_a_recorder_killed_before_its_first_row_is_repaired_once(tmp_path: Path) -> None:
    folder = leave(tmp_path, new_run(), [])
    assert recover(folder).changed
    assert len(verify(folder).findings) == 1
    assert not recover(folder).changed


@pytest.mark.parametrize("journal", ["none", "damaged"])
def test_an_unlisted_part_that_the_journal_may_not_have_is_kept_aside(left: Path, journal: str) -> None:
    if journal == "none":
        recover(left)
    else:
        path = max(numbered_files(left, SEGMENTS).values())
        flip(path, path.stat().st_size // 2)
    stray = left / "touch/part-000007.parquet"
    copyfile(left / "touch/part-000000.parquet", stray)
    data = stray.read_bytes()
    assert "touch/part-000007.parquet: is not in the manifest" in recover(left).done
    assert (left / "damaged/touch-part-000007.parquet").read_bytes() == data
    assert rows(left, BATCHES) >= [20, 20, 20, 20, 0]
    assert not recover(left).changed
    copyfile(left / "touch/part-000000.parquet", stray)
    recover(left)
    assert (left / "damaged/touch-part-000007.parquet.1").exists()


@pytest.mark.parametrize("damage", ["missing", "flipped"])
def test_a_listed_part_that_is_damaged_is_made_again_from_the_journal(left: Path, damage: str) -> None:
    path = left / "motion/part-000001.parquet"
    path.unlink() if damage == "missing" else flip(path, 200)
    assert verify(left).worst == "lost"
    done = recover(left)
    assert (done.rows["motion"], done.lost) == (15, [])
    assert "part-000001.parquet: " in done.done[0]
    assert done.done[0].endswith("; the journal has its rows")
    assert rows(left, BATCHES) == ALL
    assert (left / "damaged/motion-part-000001.parquet").exists() == (damage == "flipped")
    assert verify(left).worst == "repaired"


def test_rows_of_a_damaged_part_that_the_journal_lacks_are_lost(left: Path) -> None:
    flip(left / "touch/part-000001.parquet", 200)
    path, last = numbered_files(left, SEGMENTS).values()
    last.unlink()
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert recover(left).lost[-1] == "touch: 10 rows of damaged parts, after row 30"
    assert verify(left).worst == "lost"


@pytest.mark.parametrize("damage", ["missing", "flipped"])
def test_without_its_manifest_a_session_is_refused_reported_and_not_changed(left: Path, damage: str) -> None:
    path = left / "MANIFEST.json"
    if damage == "missing":
        path.unlink()
    else:
        path.write_text(path.read_text().replace('"rows": 20', '"rows": 21', 1))
    before = contents(left)
    for use in (recover, Session.open):
        with pytest.raises(InputError, match=r"MANIFEST\.json: (cannot be read|is damaged)"):
            use(left)
    found = verify(left)
    assert found.worst == "lost"
    assert "MANIFEST.json" in found.findings[0].text
    assert contents(left) == before


def test_damage_in_the_middle_ends_the_tables_there_and_the_segment_is_kept(left: Path) -> None:
    path = max(numbered_files(left, SEGMENTS).values())
    data = path.read_bytes()
    for name in ("touch/part-000009.parquet.tmp", "mine.tmp"):
        (left / name).write_text("half")
    data = flip(path, data.rindex(b"SLIP", 0, data.rindex(b"SLIP")) + 20)  # in the last frame but one
    done = recover(left)
    assert "it is damaged" in done.lost[0]
    assert recovered(left)["cut"] == []
    assert (left / "damaged" / f"journal-{path.name}").read_bytes() == data
    assert list(left.rglob("*.tmp")) == [left / "mine.tmp"]
    assert [20] * 4 <= rows(left, BATCHES) < ALL
    for _ in range(2):
        assert verify(left).worst == "lost"
        assert not recover(left).changed


@pytest.mark.parametrize("tail", ["cut", "zeros"])
def test_a_torn_end_costs_its_own_rows_only(left: Path, tail: str) -> None:
    path = max(numbered_files(left, SEGMENTS).values())
    data = path.read_bytes()
    torn = data[: data.rindex(b"SLIP")] + bytes(100) if tail == "zeros" else data[:-1]
    path.write_bytes(torn)
    assert verify(left).worst == "lossy"
    done = recover(left)
    assert "the recorder was cut off there" in done.lost[0]
    assert recovered(left)["cut"] == list(done.lost)
    assert rows(left, BATCHES) == [25, 25, 25, 25, 20]
    assert not (left / "damaged").exists()
    assert verify(left).worst == "lossy"


def test_a_torn_end_of_an_older_segment_is_a_loss(left: Path) -> None:
    path = min(numbered_files(left, SEGMENTS).values())
    path.write_bytes(path.read_bytes()[:-1])
    assert "the recorder was cut off there" in recover(left).lost[0]
    assert recovered(left)["cut"] == []
    assert verify(left).worst == "lost"


def test_rows_of_another_number_of_cells_are_left_out_and_reported(left: Path) -> None:
    log = AppendLog(
        left / "journal/000003.wal", identity("one", 3), encode([NumberedRows(50, Touch.zeros(2, 9))])
    )
    log.close()
    assert recover(left).lost == ["touch: 2 rows that do not follow row 50"]


def test_rows_that_do_not_follow_are_left_out_and_reported(left: Path) -> None:
    listed = read_manifest(left)
    for name in ("motion/part-000000.parquet", "motion/part-000001.parquet"):
        del listed[name]
        (left / name).unlink()
    write_manifest(left, listed.values())
    assert recover(left).lost == ["motion: 15 rows that do not follow row 0"]
    assert rows(left, BATCHES) == [25, 25, 0, 25, 25]
    assert list((left / "damaged").glob("*.wal"))


@pytest.mark.parametrize("lost", ["all", "segments"])
def test_a_session_that_was_not_closed_and_lacks_its_journal_says_so(left: Path, lost: str) -> None:
    for path in numbered_files(left, SEGMENTS).values():
        path.unlink()
    if lost == "all":
        rmtree(left / "journal")
    for _ in range(2):
        assert verify(left).worst == "lost"
        recover(left)
    assert "lacks its journal" in recovered(left)["lost"][0]


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"version": 3}, "has version 3 or other columns; .* reads 7: recover it with the software named"),
        ({"columns": "0f"}, "has version 7 or other columns"),
        ({"session": "two"}, "is segment 3 of session 'two'; move it back there"),
        ({"segment": 4}, "is segment 4 of session 'one'"),
    ],
)
def test_a_journal_of_another_version_or_session_is_refused_and_nothing_is_changed(
    left: Path, changes: dict[str, Any], complaint: str
) -> None:
    about: dict[str, Any] = json.loads(identity("one", 3)) | changes
    AppendLog(left / "journal/000003.wal", json.dumps(about).encode()).close()
    before = contents(left)
    with pytest.raises(InputError, match=rf"000003\.wal: {complaint}"):
        recover(left)
    assert contents(left) == before


@pytest.mark.parametrize("name", ["damaged", "journal/000007.wal", "slips.parquet", "MANIFEST.json"])
def test_a_link_is_refused_and_nothing_is_changed(left: Path, tmp_path: Path, name: str) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    for each in ("MANIFEST.json", "slips.parquet", "000007.wal"):
        (mine / each).write_text("mine")
    (left / name).unlink(missing_ok=True)
    (left / name).symlink_to(mine if "." not in name else mine / Path(name).name)
    for use in (recover, Session.open):
        with pytest.raises(InputError, match="is a link; a session must have none"):
            use(left)
    found = verify(left)
    assert (found.code, "is a link" in found.findings[-1].text) == (1, True)
    assert [path.read_text() for path in mine.iterdir()] == ["mine"] * 3


@pytest.mark.parametrize("name", ["touch/part-000001.parquet", "journal/000001.wal", "MANIFEST.json"])
def test_a_file_that_cannot_be_read_is_not_reported_as_damaged(
    left: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def fail(path: Path, **named: bool) -> int:
        if path == left / name:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return real(path, **named)

    real, before = files.open_file, contents(left)
    with monkeypatch.context() as patch:
        patch.setattr(files, "open_file", fail)
        with pytest.raises(EndpointError, match="Input/output error"):
            verify(left)
        if not name.startswith("touch"):  # a recovery reads no listed part but the last
            with pytest.raises(EndpointError, match="Input/output error"):
                recover(left)
            assert contents(left) == before
    assert not recover(left).lost


def test_concurrent_recoveries_see_all_rows(left: Path) -> None:
    async def four() -> list[list[int]]:
        return await asyncio.gather(*(asyncio.to_thread(rows, left, BATCHES) for _ in range(4)))

    assert asyncio.run(four()) == [ALL] * 4
