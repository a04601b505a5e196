import asyncio
import json
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from shutil import copyfile, copytree, rmtree
from threading import Event
from typing import Any, cast

import polars as pl
import pytest

from operators.batch import Batch, Labelled, Motion, Slips, Touch, Zeroed, concat, ms
from operators.errors import EndpointError, InputError
from operators.ports import Json, Run
from storage import Dataset, Session, frames, recover, verify
from storage.frames import read_segment
from storage.layout import TABLE_OF, TOUCH, episode_log, segments, single_log
from storage.lock import lock
from storage.manifest import read_manifest, write_manifest
from storage.parts import read_part, write_part
from storage.schema import schema
from storage.steps import STEPS
from storage.writer import SessionWriter

STREAMS: list[tuple[type[Batch], int]] = [(Touch, 0), (Touch, 1), (Motion, -1), (Labelled, 0), (Slips, 0)]
SCRIPT = Path(__file__).with_name("kill_points.py")
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def batches(new_batch: Callable[..., Any]) -> list[Batch]:
    """Five streams side by side, 5 rows and 50 ms at a time."""
    return [
        new_batch(kind, 5, start=turn * 50 * ms, finger=finger, seed=100 * turn + number)
        for turn in range(5)
        for number, (kind, finger) in enumerate(STREAMS)
    ]


def leave(root: Path, run: Run, batches: Sequence[Batch]) -> Path:
    """Record and never close: two parts of each table, 5 rows (10 of touch) in the journal."""
    writer = SessionWriter(root, run, part_span=100 * ms, part_rows=1000)
    for batch in batches:
        if writer.full(batch):
            writer.commit()
        if not writer.add(batch):
            writer.append(batch)
    return writer.folder


@pytest.fixture
def left(tmp_path: Path, new_run: Callable[..., Run], batches: list[Batch]) -> Path:
    return leave(tmp_path / "data", new_run(), batches)


def rows(folder: Path, batches: Sequence[Batch]) -> list[int]:
    """How many there are of each stream, once it is sure that they are its beginning, bit for bit."""
    session, counts = Session.open(folder), list[int]()
    for kind, finger in STREAMS:
        found = concat(kind, list(session.read(kind, finger)))
        written = concat(kind, [batch for batch in batches if type(batch) is kind and batch.finger == finger])
        for name in TABLE_OF[kind].columns:
            assert getattr(found, name).tobytes() == getattr(written, name)[: len(found)].tobytes()
        counts.append(len(found))
    return counts


def test_what_only_the_journal_had_is_back_in_listed_parts(left: Path, batches: list[Batch]) -> None:
    done = recover(left)
    assert done.rows == {"touch": 10, "motion": 5, "samples": 5, "slips": 25}
    assert (done.adopted, done.lost, done.complete) == ((), (), True)
    assert rows(left, batches) == [25] * 5
    assert {path.relative_to(left).as_posix() for path in left.rglob("*.parquet")} == set(read_manifest(left))
    assert not (left / "journal").exists()
    about: Any = Session.open(left).about
    assert (about["complete"], about["error"]) == (False, "was not closed")
    assert about["end_ns"] == int(batches[-1].time[-1])
    assert about["recovered"]["rows"] == dict(done.rows)


def test_a_second_recovery_finds_nothing_to_do_and_changes_nothing(left: Path) -> None:
    assert recover(left).changed
    before = {path: path.read_bytes() for path in left.rglob("*") if path.is_file()}
    assert not recover(left).changed
    assert {path: path.read_bytes() for path in left.rglob("*") if path.is_file()} == before


def test_a_session_that_was_closed_needs_nothing(
    tmp_path: Path, new_run: Callable[..., Run], batches: list[Batch]
) -> None:
    async def main() -> None:
        dataset = Dataset(tmp_path)
        await dataset.open(new_run())
        for batch in batches:
            await dataset.write(cast("Any", batch))
        await dataset.close()

    asyncio.run(main())
    folder = tmp_path / "sessions/one"
    before = (folder / "session.json").read_bytes()
    assert not recover(folder).changed
    assert (folder / "session.json").read_bytes() == before
    assert Session.open(folder).about["complete"] is True


def test_a_session_that_is_being_recorded_is_left_alone(left: Path, batches: list[Batch]) -> None:
    held = lock(left)
    assert held is not None
    with pytest.raises(EndpointError, match="one: is being recorded just now"):
        recover(left)
    assert rows(left, batches) == [20, 20, 20, 20, 0]


def test_a_part_that_was_not_listed_yet_is_listed_and_its_rows_are_there_once(
    left: Path, tmp_path: Path, batches: list[Batch]
) -> None:
    whole = tmp_path / "whole"
    copytree(left, whole)
    recover(whole)
    for name in ("touch/part-000002.parquet", "slips.parquet"):
        (left / name).write_bytes((whole / name).read_bytes())
    done = recover(left)
    assert done.adopted == ("touch/part-000002.parquet", "slips.parquet")
    assert done.rows == {"touch": 10, "motion": 5, "samples": 5, "slips": 25}
    assert rows(left, batches) == [25] * 5


@pytest.mark.parametrize("damage", ["lost", "flipped"])
def test_a_manifest_that_is_gone_is_made_again_from_whole_parts(
    left: Path, batches: list[Batch], damage: str
) -> None:
    path = left / "MANIFEST.json"
    listed = read_manifest(left)
    if damage == "lost":
        path.unlink()
    else:
        text = path.read_text().replace('"rows": 20', '"rows": 21', 1)
        assert text != path.read_text()
        path.write_text(text)
    assert set(recover(left).adopted) == set(listed)
    assert {name: read_manifest(left)[name] for name in listed} == listed
    assert rows(left, batches) == [25] * 5


def test_with_manifest_and_a_part_damaged_nothing_is_joined_that_may_not_follow(left: Path) -> None:
    (left / "MANIFEST.json").unlink()
    (left / "touch/part-000000.parquet").write_bytes(b"gone")
    done = recover(left)
    assert not done.complete
    assert "touch" in done.lost[0]
    assert "touch: 10 rows that do not follow on row" in done.lost[1]
    assert (left / "damaged/touch-part-000000.parquet").read_bytes() == b"gone"
    assert list((left / "damaged").glob("*.wal"))
    session = Session.open(left)
    found = concat(Touch, list(session.read(Touch, 0)))
    assert found.time.tolist() == [n * 10 * ms for n in range(10, 20)]
    assert len(session.frame("motion")) == 25


def test_damage_in_the_middle_ends_the_tables_there_and_what_is_behind_it_is_kept_aside(
    left: Path, batches: list[Batch]
) -> None:
    [path] = segments(left).values()
    data = bytearray(path.read_bytes())
    frame = data.rindex(b"SLIP", 0, data.rindex(b"SLIP"))  # the last but one
    data[frame + 20] ^= 4
    path.write_bytes(data)
    done = recover(left)
    assert not done.complete
    assert "whole frames are behind it" in done.lost[0]
    assert (left / "damaged" / f"journal-{path.name}").read_bytes() == data
    counts = rows(left, batches)
    assert [20] * 4 <= counts < [25] * 5
    assert verify(left).worst == "lost"
    assert not recover(left).changed
    assert verify(left).worst == "lost"


def test_what_came_back_whole_is_repaired(left: Path) -> None:
    assert (verify(left).code, verify(left).worst) == (3, "repairable")
    recover(left)
    assert (verify(left).code, verify(left).worst) == (3, "repaired")


@pytest.mark.parametrize("manifest", ["whole", "gone"])
def test_a_copy_of_a_part_is_put_aside_and_told_of(left: Path, batches: list[Batch], manifest: str) -> None:
    recover(left)
    copyfile(left / "touch/part-000000.parquet", left / "touch/part-000007.parquet")
    if manifest == "gone":
        (left / "touch/part-000007.parquet").rename(left / "touch/part-000003.parquet")
        (left / "MANIFEST.json").unlink()
    done = recover(left)
    assert "is a copy of touch/part-000000.parquet" in done.done[0]
    assert done.changed
    assert rows(left, batches) == [25] * 5
    assert [path.name[:10] for path in (left / "damaged").iterdir()] == ["touch-part"]
    assert verify(left).worst == "repaired"
    assert not recover(left).changed


def test_rows_that_are_there_already_in_other_words_are_put_aside(left: Path, batches: list[Batch]) -> None:
    recover(left)
    again = read_part(left / "touch/part-000002.parquet", schema(TOUCH)).slice(2)
    write_part(left / "touch/part-000003.parquet", again)
    assert len(Session.open(left).frame("touch")) == 50
    [told] = recover(left).done
    assert "part-000003.parquet: has rows of the same time as touch/part-000002.parquet" in told
    assert rows(left, batches) == [25] * 5


def test_fingertips_may_share_the_time_of_another_part(
    tmp_path: Path, new_run: Callable[..., Run], new_batch: Callable[..., Any]
) -> None:
    folder = leave(tmp_path, new_run(), [new_batch(Touch, finger=finger) for finger in (0, 1)])
    recover(folder)
    whole = read_part(folder / "touch/part-000000.parquet", schema(TOUCH))
    write_part(folder / "touch/part-000000.parquet", whole.slice(0, 5))
    write_part(folder / "touch/part-000001.parquet", whole.slice(5))
    (folder / "MANIFEST.json").unlink()
    assert recover(folder).adopted == ("touch/part-000000.parquet", "touch/part-000001.parquet")


@pytest.mark.parametrize("number", [0, 1])
def test_a_damaged_manifest_still_tells_of_a_part_that_is_gone_with_it(left: Path, number: int) -> None:
    recover(left)
    (left / f"touch/part-00000{number}.parquet").unlink()
    path = left / "MANIFEST.json"
    path.write_text(path.read_text().replace('"rows": 20', '"rows": 21'))
    damaged = path.read_bytes()
    done = recover(left)
    assert f"touch/part-00000{number}.parquet: is gone: 2" in done.lost[0]
    assert (left / "damaged/MANIFEST.json").read_bytes() == damaged
    for _ in range(2):
        assert verify(left).worst == "lost"
        assert not recover(left).changed


def test_a_part_that_is_gone_with_the_manifest_is_missed_by_its_number(left: Path) -> None:
    recover(left)
    for name in ("touch/part-000001.parquet", "MANIFEST.json"):
        (left / name).unlink()
    before = verify(left)
    assert before.code == 1
    assert "touch/part-000001.parquet: is gone" in " ".join(each.text for each in before.findings)
    assert recover(left).lost == ("touch/part-000001.parquet: is gone, and no manifest tells of it",)
    found = [each.text for each in verify(left).findings if each.weight == "lost"]
    assert found == [
        "lost before it was recovered: touch/part-000001.parquet: is gone, and no manifest tells of it"
    ]


def test_a_segment_that_is_gone_is_lost(left: Path, batches: list[Batch]) -> None:
    [path] = segments(left).values()
    later = path.with_name(f"{int(path.stem) + 2:06d}.wal")
    about = frames.describe("one", int(later.stem))
    salt = frames.new_salt()
    later.write_bytes(salt + frames.seal(about, salt, len(salt)))
    name = f"journal/{int(path.stem) + 1:06d}.wal: is gone"
    assert verify(left).worst == "lost"
    assert name in recover(left).lost[0]
    assert rows(left, batches) == [25] * 5
    assert verify(left).worst == "lost"


def test_a_journal_without_segments_is_lost_once_rows_were_committed(left: Path) -> None:
    for path in segments(left).values():
        path.unlink()
    assert verify(left).worst == "lost"
    assert "has no segment" in recover(left).lost[0]
    assert verify(left).worst == "lost"
    assert not (left / "journal").exists()


def test_a_session_that_lost_its_journal_is_told_to_be_cut_off(left: Path) -> None:
    rmtree(left / "journal")
    done = recover(left)
    assert done.cut == done.lost
    assert "has no journal" in done.lost[0]
    assert verify(left).worst == "lossy"


def test_whatever_is_changed_is_told(left: Path) -> None:
    recover(left)
    (left / "MANIFEST.json.tmp").write_text("half")
    assert recover(left).done == ("1 files that were never whole were deleted",)
    (left / "journal").mkdir()
    assert "its journal was put away" in recover(left).done[0]
    assert not recover(left).changed


def test_rows_that_do_not_follow_are_left_out(left: Path, batches: list[Batch]) -> None:
    listed = read_manifest(left)
    del listed["motion/part-000001.parquet"]
    (left / "motion/part-000001.parquet").unlink()
    write_manifest(left, listed.values())
    done = recover(left)
    assert done.lost == ("motion: 5 rows that do not follow on row 10",)
    assert rows(left, batches) == [25, 25, 10, 25, 25]


def test_a_cut_off_end_costs_its_own_rows_only(left: Path, batches: list[Batch]) -> None:
    [path] = segments(left).values()
    data = path.read_bytes()
    segment = read_segment(data, "", "one", int(path.stem))
    while len(read_segment(data, "", "one", int(path.stem)).rows) == len(segment.rows):
        data = data[:-1]
    path.write_bytes(data)
    assert verify(left).worst == "lossy"
    done = recover(left)
    assert "there the recorder was cut off" in done.lost[0]
    assert done.cut == done.lost
    assert rows(left, batches) == [25, 25, 25, 20, 25]
    assert not (left / "damaged").exists()
    assert verify(left).worst == "lossy"


def test_samples_get_the_episodes_that_were_told_while_it_ran(
    tmp_path: Path,
    new_run: Callable[..., Run],
    new_batch: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told, noted = list[Json](), Event()

    def reach(step: str) -> None:
        if step == "sync frames" and told:
            noted.set()

    monkeypatch.setattr("storage.journal.SYNC", 0.001)
    monkeypatch.setattr("storage.steps.reach", reach)
    writer = SessionWriter(tmp_path, new_run(describe={"rig": {"episodes": told}}), 10**12, 1000)
    writer.add(new_batch(Labelled, 5))
    told.append({"start": 0, "end": 20 * ms, "motion": "hold"})
    assert noted.wait(60)  # the journal has looked since
    folder = writer.folder
    del writer
    session = Session.open(folder)
    assert session.frame("episodes")["motion"].to_list() == ["hold"]
    assert session.frame("samples")["episode"].to_list() == [0, 0, -1, -1, -1]


def test_zeroed_counts_are_said_to_be_zeroed(
    tmp_path: Path, new_run: Callable[..., Run], new_batch: Callable[..., Any]
) -> None:
    session = Session.open(leave(tmp_path, new_run(), [new_batch(Zeroed)]))
    assert session.about["zeroed"] is True
    assert [type(batch) for batch in session.read(Touch, 0)] == [Zeroed]


def test_leftovers_go_and_nothing_outside_is_touched(left: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.tmp").write_text("mine")
    (left / "touch/part-000009.parquet.tmp").write_text("half")
    (left / "MANIFEST.json.tmp").symlink_to(tmp_path / "mine.tmp")
    recover(left)
    assert list(left.rglob("*.tmp")) == []
    assert (tmp_path / "mine.tmp").read_text() == "mine"


@pytest.mark.parametrize(
    ("name", "refused"),
    [("journal/000007.wal", True), ("slips.parquet", True), ("touch", True), ("faults.parquet", False)],
)
def test_a_link_out_of_the_session_is_not_followed(
    left: Path, tmp_path: Path, name: str, *, refused: bool
) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "part-000009.parquet").write_text("mine")
    if name == "touch":
        (left / name).rename(tmp_path / "aside")
    (left / name).symlink_to(mine if name == "touch" else mine / "part-000009.parquet")
    if refused:
        with pytest.raises(InputError, match="leads out of"):
            recover(left)
    else:
        assert "leads out of" in " ".join(recover(left).lost)
    assert [path.read_text() for path in mine.iterdir()] == ["mine"]


def test_a_journal_of_another_slipflow_is_refused_and_nothing_is_changed(
    left: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {path: path.read_bytes() for path in left.rglob("*") if path.is_file()}
    monkeypatch.setattr("storage.frames.VERSION", 7)
    with pytest.raises(InputError, match=r"\.wal: is of version 2, this slipflow knows 7"):
        recover(left)
    assert {path: path.read_bytes() for path in left.rglob("*") if path.is_file()} == before


def test_a_disk_that_is_full_leaves_all_as_it_was_for_another_try(
    left: Path, batches: list[Batch], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(step: str) -> None:
        if step == "sync manifest":
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("storage.steps.reach", fail)
        with pytest.raises(EndpointError, match="cannot be recovered: No space left on device"):
            recover(left)
    done = recover(left)
    assert done.rows["touch"] == 10
    assert rows(left, batches) == [25] * 5


def test_two_that_recover_at_once_both_see_all(left: Path, batches: list[Batch]) -> None:
    async def both() -> list[list[int]]:
        return await asyncio.gather(*(asyncio.to_thread(rows, left, batches) for _ in range(4)))

    assert asyncio.run(both()) == [[25] * 5] * 4


@pytest.mark.parametrize("seed", range(300))
def test_a_flipped_bit_in_the_journal_never_gives_a_wrong_row(
    left_whole: Path, tmp_path: Path, batches: list[Batch], seed: int
) -> None:
    folder = tmp_path / "one"
    copytree(left_whole, folder)
    [path] = segments(folder).values()
    data = bytearray(path.read_bytes())
    place = seed * len(data) // 300
    data[place] ^= 1 << seed % 8
    path.write_bytes(data)
    assert not recover(folder).complete
    assert rows(folder, batches) >= [20, 20, 20, 20, 0]


@pytest.fixture(scope="module")
def left_whole(
    tmp_path_factory: pytest.TempPathFactory, new_run: Callable[..., Run], batches: list[Batch]
) -> Path:
    return leave(tmp_path_factory.mktemp("data"), new_run(), batches)


def kill(*arguments: str | Path) -> dict[str, int]:
    done = subprocess.run(
        [sys.executable, SCRIPT, *arguments],
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    counts: dict[str, int] = json.loads(done.stdout)
    return counts


def numbers(session: Session, kind: type[Batch], finger: int) -> list[int]:
    return [time // (10 * ms) for batch in session.read(kind, finger) for time in batch.time.tolist()]


def stroke(number: int) -> dict[str, Json]:
    """An episode of those that the script records."""
    return {"start": 40 * number * ms, "end": 40 * (number + 1) * ms, "motion": "tap"}


def test_a_log_of_single_files_that_is_gone_is_told_of(left: Path, batches: list[Batch]) -> None:
    single_log(left).unlink()
    assert verify(left).worst == "lost"
    assert "journal/single.wal: is gone, with the rows that it held" in recover(left).lost
    assert rows(left, batches) == [25, 25, 25, 25, 0]


def test_slips_that_were_looked_for_and_not_found_are_a_file_without_rows(
    tmp_path: Path, new_run: Callable[..., Run], batches: list[Batch]
) -> None:
    run = new_run()
    run.wired = {str(tmp_path): (Touch, Slips)}
    folder = leave(tmp_path, run, [batch for batch in batches if type(batch) is Touch])
    assert recover(folder).lost == ()
    session = Session.open(folder)
    assert session.tables == ("touch", "slips")
    assert len(session.frame("slips")) == 0
    assert session.about["end_ns"] == int(batches[-1].time[-1])
    assert not recover(folder).changed


def test_slips_that_may_have_been_lost_are_not_said_to_be_none(
    tmp_path: Path, new_run: Callable[..., Run], batches: list[Batch]
) -> None:
    run = new_run()
    run.wired = {str(tmp_path): (Touch, Slips)}
    folder = leave(tmp_path, run, [batch for batch in batches if type(batch) is Touch])
    single_log(folder).unlink()
    assert "single.wal: is gone" in " ".join(recover(folder).lost)
    assert Session.open(folder).tables == ("touch",)


def test_a_replay_killed_at_any_step_is_whole_or_says_that_it_is_not(tmp_path: Path) -> None:
    counts = kill("replay", tmp_path)
    reached = {step for step in STEPS if counts[step]}
    assert reached == {
        *(
            f"{each} {what}"
            for each in ("write", "rename", "sync")
            for what in ("part", "session", "manifest")
        ),
        *(f"{each} dataset" for each in ("write", "rename", "sync", "settle")),
        "settle session",
    }
    for place in tmp_path.iterdir():
        folder = place / "sessions/one"
        if not (folder / "session.json").exists():
            continue
        before = Session.open(place).about["complete"]
        assert verify(place).code == (0 if before else 3), place  # lossy, and said to be
        assert recover(folder).complete == (before or not list(folder.glob("*/*.parquet"))), place
        session = Session.open(place)
        assert session.about["complete"] is before
        for kind, finger in ((Touch, 0), (Motion, -1), (Slips, 0)):
            found = numbers(session, kind, finger)
            assert found == list(range(len(found))), place
            assert len(found) == 45 or not before, place


def test_a_recorder_killed_at_any_step_loses_the_last_rows_at_most(tmp_path: Path) -> None:
    counts = kill("record", tmp_path)
    assert [step for step in STEPS if not counts[step]] == []
    for place in tmp_path.iterdir():
        taken = len((place / "taken").read_bytes())
        if not (place / "sessions/one/session.json").exists():
            assert taken == 0
            continue
        parts = [pl.read_parquet(path) for path in place.glob("sessions/one/touch/*.parquet")]
        committed = max((time for frame in parts for time in frame["time"].to_list()), default=-1)
        assert recover(place / "sessions/one").complete, place
        session = Session.open(place)
        for kind, finger in ((Touch, 0), (Motion, -1), (Slips, 0)):
            found = numbers(session, kind, finger)
            assert found == list(range(len(found))), place
            assert len(found) >= taken - 10, place
        told: Any = session.describe().get("episodes", [])
        keys = ("start", "end", "motion")
        found_episodes = [{key: each[key] for key in keys} for each in told]
        assert found_episodes[:-1] == [stroke(n) for n in range(len(told) - 1)], place
        assert len(told) > committed // (4 * 10 * ms), place
        assert verify(place).code in {0, 3}, place
        assert list(place.rglob("*.tmp")) == list(place.glob("*.tmp")), place


def test_a_recovery_killed_at_any_step_is_carried_out_by_the_next(
    left: Path, tmp_path: Path, batches: list[Batch]
) -> None:
    (tmp_path / "killed").mkdir()
    counts = kill("recover", left, tmp_path / "killed")
    reached = {step for step in STEPS if counts[step]}
    assert reached >= {
        f"{each} {what}" for each in ("write", "rename") for what in ("part", "session", "manifest")
    }
    assert reached >= {"drop segment", "drop journal"}
    for place in (tmp_path / "killed").iterdir():
        recover(place)
        assert rows(place, batches) == [25] * 5, place
        about: Any = Session.open(place).about
        assert about["recovered"]["rows"] == {"touch": 10, "motion": 5, "samples": 5, "slips": 25}, place


def episodes(*starts: int) -> list[Json]:
    return [{"start": start * ms, "end": (start + 10) * ms, "motion": "tap"} for start in starts]


def starts(folder: Path) -> list[int]:
    return [start // ms for start in Session.open(folder).frame("episodes")["start"].to_list()]


def test_a_file_of_episodes_that_was_just_being_replaced_costs_none(
    tmp_path: Path, new_run: Callable[..., Run]
) -> None:
    told = episodes(0)
    writer: Any = SessionWriter(tmp_path, new_run(describe={"rig": {"episodes": told}}), 10**12, 1000)
    told += episodes(10, 20)
    writer._journal.keep_episodes()
    writer._commit_episodes(final=True)  # and is killed before the manifest
    del writer
    folder = tmp_path / "sessions/one"
    assert recover(folder).complete
    assert starts(folder) == [0, 10, 20]
    assert verify(tmp_path).worst == "lossy"  # it was never closed


def test_a_source_that_began_anew_is_believed(tmp_path: Path, new_run: Callable[..., Run]) -> None:
    told = episodes(0, 10, 20)
    writer: Any = SessionWriter(tmp_path, new_run(describe={"rig": {"episodes": told}}), 10**12, 1000)
    writer._journal.keep_episodes()
    told[:] = episodes(40)
    del writer
    assert starts(tmp_path / "sessions/one") == [40]


@pytest.mark.parametrize(
    ("frame", "weight", "left_over"),
    [(0, "lost", [0]), (1, "lost", [0]), (2, "lost", [0, 10]), (3, "lossy", [0, 10, 20])],
)
def test_damage_to_what_the_journal_tells_of_episodes_costs_those_behind_it_and_no_row(
    tmp_path: Path,
    new_run: Callable[..., Run],
    new_batch: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    *,
    frame: int,
    weight: str,
    left_over: list[int],
) -> None:
    monkeypatch.setattr("storage.journal.SYNC", 3600.0)
    told = episodes(0)
    writer: Any = SessionWriter(tmp_path, new_run(describe={"rig": {"episodes": told}}), 10**12, 1000)
    writer.append(new_batch(Labelled))
    for start in (10, 20, 30):
        told += episodes(start)
        writer._journal.keep_episodes()
    folder, path = writer.folder, episode_log(writer.folder)
    del writer
    data = bytearray(path.read_bytes())
    places = [match.start() for match in re.finditer(b"SLIP", data)][1:]  # the file begins so, too
    assert len(places) == 4
    data[places[frame] + 20] ^= 1
    path.write_bytes(data)
    assert verify(folder).worst == weight
    done = recover(folder)
    assert done.rows == {"samples": 5}
    assert "episodes.wal: its last" in done.lost[0]
    assert starts(folder) == left_over
    assert (folder / "damaged/journal-episodes.wal").exists() == (weight == "lost")


def test_episodes_that_cannot_be_cost_no_row(
    tmp_path: Path, new_run: Callable[..., Run], new_batch: Callable[..., Any]
) -> None:
    told = list[Json]()
    writer: Any = SessionWriter(tmp_path, new_run(describe={"rig": {"episodes": told}}), 10**12, 1000)
    told += [{"start": 0, "end": 20 * ms}, {"start": 10 * ms, "end": 30 * ms}]  # they overlap
    writer.append(new_batch(Touch, 1))
    writer._leave()  # tells at last
    recovery = recover(writer.folder)
    assert recovery.rows == {"touch": 1}
    assert [each.partition(":")[0] for each in recovery.lost] == ["episodes"]
