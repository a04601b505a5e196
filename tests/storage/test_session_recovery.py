import errno
import os
from collections.abc import Callable
from pathlib import Path
from shutil import copyfile, copytree, rmtree
from typing import Any

import pytest

from operators.batch import Slips, Touch, Zeroed, concat, ms
from operators.errors import InputError, SlipflowError
from storage import Session, recover, verify
from storage.append_log import AppendLog
from storage.journal import identity
from storage.layout import TOUCH, segments, single_log
from storage.manifest import read_manifest, write_manifest
from storage.parts import read_part, write_part
from storage.schema import schema
from tests.storage.made import leave, new_batch, new_run, rows, side_by_side

BATCHES = side_by_side(5)
VERSION_BYTE = 7  # of a log


@pytest.fixture
def left(tmp_path: Path) -> Path:
    return leave(tmp_path / "data", new_run(), BATCHES)


def test_a_part_that_was_not_listed_yet_is_listed_and_its_rows_are_there_once(
    left: Path, tmp_path: Path
) -> None:
    whole = tmp_path / "whole"
    copytree(left, whole)
    recover(whole)
    for name in ("touch/part-000002.parquet", "slips.parquet"):
        (left / name).write_bytes((whole / name).read_bytes())
    done = recover(left)
    assert done.adopted == ("touch/part-000002.parquet", "slips.parquet")
    assert done.rows == {"touch": 10, "motion": 5, "samples": 5, "slips": 25}
    assert rows(left, BATCHES) == [25] * 5


@pytest.mark.parametrize("damage", ["lost", "flipped", "pipe"])
def test_a_missing_manifest_is_rewritten_from_whole_parts(left: Path, damage: str) -> None:
    path = left / "MANIFEST.json"
    listed = read_manifest(left)
    if damage != "flipped":
        path.unlink()
    if damage == "pipe":
        os.mkfifo(path)
    if damage == "flipped":
        text = path.read_text().replace('"rows": 20', '"rows": 21', 1)
        assert text != path.read_text()
        path.write_text(text)
    assert set(recover(left).adopted) == set(listed)
    assert {name: read_manifest(left)[name] for name in listed} == listed
    assert rows(left, BATCHES) == [25] * 5


def test_with_manifest_and_a_part_damaged_nothing_is_joined_that_may_not_follow(left: Path) -> None:
    (left / "MANIFEST.json").unlink()
    (left / "touch/part-000000.parquet").write_bytes(b"gone")
    done = recover(left)
    assert not done.complete
    assert "touch" in done.lost[0]
    assert "touch: 30 rows that do not follow row 20" in done.lost[1]
    assert (left / "damaged/touch-part-000000.parquet").read_bytes() == b"gone"
    assert list((left / "damaged").glob("*.wal"))
    session = Session.open(left)
    found = concat(Touch, list(session.read(Touch, 0)))
    assert found.time.tolist() == [n * 10 * ms for n in range(10, 20)]
    assert len(session.frame("motion")) == 25


def test_damage_in_the_middle_ends_the_tables_there_and_the_rest_is_kept(left: Path) -> None:
    path = max(segments(left).values())
    data = bytearray(path.read_bytes())
    frame = data.rindex(b"SLIP", 0, data.rindex(b"SLIP"))  # the last but one
    data[frame + 20] ^= 4
    path.write_bytes(data)
    done = recover(left)
    assert not done.complete
    assert "whole frames follow" in done.lost[0]
    assert (left / "damaged" / f"journal-{path.name}").read_bytes() == data
    counts = rows(left, BATCHES)
    assert [20] * 4 <= counts < [25] * 5
    assert verify(left).worst == "lost"
    assert not recover(left).changed
    assert verify(left).worst == "lost"


@pytest.mark.parametrize("manifest", ["whole", "gone"])
def test_a_copy_of_a_part_is_moved_away_and_reported(left: Path, manifest: str) -> None:
    recover(left)
    copyfile(left / "touch/part-000000.parquet", left / "touch/part-000007.parquet")
    if manifest == "gone":
        (left / "touch/part-000007.parquet").rename(left / "touch/part-000003.parquet")
        (left / "MANIFEST.json").unlink()
    done = recover(left)
    assert "is a copy of touch/part-000000.parquet" in done.done[0]
    assert done.changed
    assert rows(left, BATCHES) == [25] * 5
    assert [path.name[:10] for path in (left / "damaged").iterdir()] == ["touch-part"]
    assert verify(left).worst == "repaired"
    assert not recover(left).changed


def test_fingertips_may_share_the_time_of_another_part(tmp_path: Path) -> None:
    folder = leave(tmp_path, new_run(), [new_batch(Touch, finger=finger) for finger in (0, 1)])
    recover(folder)
    whole = read_part(folder / "touch/part-000000.parquet", schema(TOUCH))
    write_part(folder / "touch/part-000000.parquet", whole.slice(0, 5))
    write_part(folder / "touch/part-000001.parquet", whole.slice(5))
    (folder / "MANIFEST.json").unlink()
    assert recover(folder).adopted == ("touch/part-000000.parquet", "touch/part-000001.parquet")


@pytest.mark.parametrize("number", [0, 1])
def test_a_damaged_manifest_still_names_a_missing_part(left: Path, number: int) -> None:
    recover(left)
    (left / f"touch/part-00000{number}.parquet").unlink()
    path = left / "MANIFEST.json"
    path.write_text(path.read_text().replace('"rows": 20', '"rows": 21'))
    damaged = path.read_bytes()
    done = recover(left)
    assert f"touch/part-00000{number}.parquet: is missing" in done.lost[0]
    assert (left / "damaged/MANIFEST.json").read_bytes() == damaged
    for _ in range(2):
        assert verify(left).worst == "lost"
        assert not recover(left).changed


def test_a_part_missing_with_the_manifest_is_found_by_its_number(left: Path) -> None:
    recover(left)
    for name in ("touch/part-000001.parquet", "MANIFEST.json"):
        (left / name).unlink()
    before = verify(left)
    assert before.code == 1
    assert "touch/part-000001.parquet: is missing" in " ".join(each.text for each in before.findings)
    assert recover(left).lost == ("touch/part-000001.parquet: is missing, and not in the manifest",)
    found = [each.text for each in verify(left).findings if each.weight == "lost"]
    assert found == [
        "lost before it was recovered: touch/part-000001.parquet: is missing, and not in the manifest"
    ]


def test_a_missing_segment_is_lost(left: Path) -> None:
    path = max(segments(left).values())
    later = path.with_name(f"{int(path.stem) + 2:06d}.wal")
    AppendLog.create(later, identity("one", int(later.stem))).close()
    name = f"journal/{int(path.stem) + 1:06d}.wal: is missing"
    assert verify(left).worst == "lost"
    assert name in recover(left).lost[0]
    assert rows(left, BATCHES) == [25] * 5
    assert verify(left).worst == "lost"


def test_a_journal_without_segments_is_lost_once_rows_were_committed(left: Path) -> None:
    for path in segments(left).values():
        path.unlink()
    assert verify(left).worst == "lost"
    assert "has no segment" in recover(left).lost[0]
    assert verify(left).worst == "lost"
    assert not (left / "journal").exists()


def test_a_session_that_lost_its_journal_is_cut_off(left: Path) -> None:
    rmtree(left / "journal")
    done = recover(left)
    assert done.cut == done.lost
    assert "has no journal" in done.lost[0]
    assert verify(left).worst == "lossy"


def test_every_change_is_reported(left: Path) -> None:
    recover(left)
    (left / "MANIFEST.json.tmp").write_text("half")
    assert recover(left).done == ("1 incomplete files were deleted",)
    (left / "journal").mkdir()
    assert "its journal was deleted" in recover(left).done[0]
    assert not recover(left).changed


def test_rows_that_do_not_follow_are_left_out(left: Path) -> None:
    listed = read_manifest(left)
    for name in ("motion/part-000000.parquet", "motion/part-000001.parquet"):
        del listed[name]
        (left / name).unlink()
    write_manifest(left, listed.values())
    done = recover(left)
    assert done.lost == ("motion: 15 rows that do not follow row 0",)
    assert rows(left, BATCHES) == [25, 25, 0, 25, 25]


def test_the_newest_part_is_restored_from_the_journal(left: Path) -> None:
    listed = read_manifest(left)
    del listed["motion/part-000001.parquet"]
    (left / "motion/part-000001.parquet").unlink()
    write_manifest(left, listed.values())
    assert recover(left).complete
    assert rows(left, BATCHES) == [25] * 5


def test_a_cut_off_end_costs_its_own_rows_only(left: Path) -> None:
    path = max(segments(left).values())
    path.write_bytes(path.read_bytes()[:-1])
    assert verify(left).worst == "lossy"
    done = recover(left)
    assert "the recorder was cut off there" in done.lost[0]
    assert done.cut == done.lost
    assert rows(left, BATCHES) == [25, 25, 25, 20, 25]
    assert not (left / "damaged").exists()
    assert verify(left).worst == "lossy"


def test_zeroed_counts_are_said_to_be_zeroed(tmp_path: Path) -> None:
    session = Session.open(leave(tmp_path, new_run(), [new_batch(Zeroed)]))
    assert session.about["zeroed"] is True
    assert [type(batch) for batch in session.read(Touch, 0)] == [Zeroed]


def test_temporary_files_are_deleted_and_folders_kept(left: Path) -> None:
    (left / "touch/part-000009.parquet.tmp").write_text("half")
    (left / "MANIFEST.json.tmp").write_text("half")
    (left / "mine.tmp").mkdir()
    recover(left)
    assert list(left.rglob("*.tmp")) == [left / "mine.tmp"]
    assert not recover(left).changed


@pytest.mark.parametrize(
    "name",
    [
        "damaged",
        "touch",
        "journal",
        "journal/000007.wal",
        "slips.parquet",
        "faults.parquet",
        "MANIFEST.json",
        "part.tmp",
    ],
)
def test_a_link_is_refused_and_nothing_is_changed(left: Path, tmp_path: Path, name: str) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    for each in ("MANIFEST.json", "part-000000.parquet", "000007.wal"):
        (mine / each).write_text("mine")
    if (left / name).exists():
        (left / name).rename(tmp_path / "aside")
    (left / "MANIFEST.json.tmp").write_text("half")
    (left / name).symlink_to(mine if "." not in name else mine / Path(name).name)
    for use in (recover, Session.open):
        with pytest.raises(InputError, match="is a link; a session must have none"):
            use(left)
    found = verify(left)
    assert (found.code, "is a link" in found.findings[-1].text) == (1, True)
    assert [path.read_text() for path in mine.iterdir()] == ["mine"] * 3
    assert (left / "MANIFEST.json.tmp").exists()


@pytest.mark.parametrize(("link", "target"), [("motion", "touch"), ("slips.parquet", "slips.parquet")])
def test_a_link_to_another_table_or_a_loop_is_refused(left: Path, link: str, target: str) -> None:
    rmtree(left / "motion")  # its rows would be committed into the other table
    before = (left / "touch/part-000000.parquet").read_bytes()
    (left / link).symlink_to(target)
    for use in (recover, Session.open):
        with pytest.raises(InputError, match="is a link; a session must have none"):
            use(left)
    assert verify(left).code == 1
    assert (left / "touch/part-000000.parquet").read_bytes() == before


@pytest.mark.parametrize("number", [errno.EACCES, errno.ENOMEM, errno.EMFILE])
@pytest.mark.parametrize("folder", ["journal", "touch", ""])
def test_a_folder_that_cannot_be_listed_is_an_error_and_nothing_is_changed(
    left: Path, monkeypatch: pytest.MonkeyPatch, folder: str, number: int
) -> None:
    before = {path: path.stat().st_mtime_ns for path in left.rglob("*")}
    with monkeypatch.context() as patch:
        for name in ("listdir", "scandir"):
            real = getattr(os, name)

            def fail(path: str | Path, real: Callable[[str | Path], Any] = real) -> Any:  # noqa: ANN401
                if Path(path) == left / folder:
                    raise OSError(number, os.strerror(number), str(path))
                return real(path)

            patch.setattr(os, name, fail)
        with pytest.raises(SlipflowError, match=f"cannot be read: {os.strerror(number)}"):
            recover(left)
    assert {path: path.stat().st_mtime_ns for path in left.rglob("*")} == before
    assert rows(left, BATCHES) == [25] * 5


def test_a_flipped_bit_in_the_journal_never_gives_a_wrong_row(left: Path, tmp_path: Path) -> None:
    paths = [*segments(left).values(), single_log(left)]
    for seed in range(60):
        folder = tmp_path / str(seed)
        copytree(left, folder)
        path = folder / paths[seed % len(paths)].relative_to(left)
        data = bytearray(path.read_bytes())
        data[seed * len(data) // 60] ^= 1 << seed % 8
        path.write_bytes(data)
        if seed * len(data) // 60 == VERSION_BYTE:
            continue  # reported as another version
        assert not recover(folder).complete
        assert rows(folder, BATCHES) >= [20, 20, 20, 20, 0]


def test_a_missing_segment_of_single_file_tables_is_reported(left: Path) -> None:
    single_log(left).unlink()
    assert verify(left).worst == "lost"
    assert "journal/single.wal: is missing, with its rows" in recover(left).lost
    assert rows(left, BATCHES) == [25, 25, 25, 25, 0]


def test_slips_that_were_looked_for_and_not_found_are_a_file_without_rows(tmp_path: Path) -> None:
    run = new_run()
    run.sink_types = {str(tmp_path): {Touch: (0,), Slips: (0,)}}
    folder = leave(tmp_path, run, [batch for batch in BATCHES if type(batch) is Touch])
    assert recover(folder).lost == ()
    session = Session.open(folder)
    assert session.tables == ("touch", "slips")
    assert len(session.frame("slips")) == 0
    assert session.about["end_ns"] == int(BATCHES[-1].time[-1])
    assert not recover(folder).changed


def test_slips_that_may_have_been_lost_are_not_said_to_be_none(tmp_path: Path) -> None:
    run = new_run()
    run.sink_types = {str(tmp_path): {Touch: (0,), Slips: (0,)}}
    folder = leave(tmp_path, run, [batch for batch in BATCHES if type(batch) is Touch])
    single_log(folder).unlink()
    assert "single.wal: is missing" in " ".join(recover(folder).lost)
    assert Session.open(folder).tables == ("touch",)


@pytest.mark.parametrize("name", ["part-000000 (copy)", "part-old", "part-\u00b2", "part-1", "part-0000001"])
def test_a_file_with_a_name_that_no_part_has_is_no_part(left: Path, name: str) -> None:
    recover(left)
    some = read_part(left / "touch/part-000000.parquet", schema(TOUCH)).slice(0, 5)
    write_part(left / f"touch/{name}.parquet", some)
    assert rows(left, BATCHES) == [25] * 5
    assert (
        f"touch/{name}.parquet: is not read: its name is not that of a part" in verify(left).findings[-1].text
    )
    assert not recover(left).changed
    (left / "MANIFEST.json").unlink()
    assert len(recover(left).adopted) == 10
    assert rows(left, BATCHES) == [25] * 5
