"""Old sessions are deleted, others never."""

import asyncio
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from operators.batch import Touch, ms, s
from operators.errors import InputError
from storage import Dataset, Session, recover, verify
from storage.hand_labels import LabelSpan
from storage.layout import session_names
from storage.retention import is_exported, mark_exported, prune
from tests.command import error, slipflow
from tests.storage.made import new_batch, new_run, new_samples, record

DAY = 86400 * s
NOW = 1_800_000_000 * s


def dataset(root: Path, **ages: float) -> Path:
    """A dataset of sessions with these ages in days."""
    for name, age in ages.items():
        session = record(root, [new_batch(Touch, 50)], name)
        written = NOW - round(age * DAY)
        os.utime(session.folder / "session.json", ns=(written, written))
    return root


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def test_sessions_are_deleted_by_age(tmp_path: Path) -> None:
    root = dataset(tmp_path, old=31, older=40, young=29)
    found = prune(root, now=NOW, older_than=30 * DAY)
    assert [(each.session, each.age // DAY, each.reason, each.kept) for each in found] == [
        ("older", 40, "its age", ""),
        ("old", 31, "its age", ""),
    ]
    assert session_names(root) == ["young"]
    assert verify(root).code == 0
    assert sorted(path.name for path in root.iterdir()) == ["dataset.json", "sessions"]


def test_the_oldest_are_deleted_until_the_dataset_is_small_enough(tmp_path: Path) -> None:
    root = dataset(tmp_path, a=1, b=4, c=3, d=2)
    each = size(root / "sessions" / "a")
    found = prune(root, now=NOW, larger_than=2 * each + each // 2)
    assert [(one.session, one.reason) for one in found] == [
        ("b", "the size of the dataset"),
        ("c", "the size of the dataset"),
    ]
    assert session_names(root) == ["a", "d"]
    assert prune(root, now=NOW, larger_than=2 * each + each // 2) == []


def test_a_dry_run_deletes_nothing_and_says_the_same(tmp_path: Path) -> None:
    root = dataset(tmp_path, a=1, b=4)
    (root / ".deleted" / "c").mkdir(parents=True)
    expected = prune(root, now=NOW, older_than=2 * DAY, dry_run=True)
    assert session_names(root) == ["a", "b"]
    assert (root / ".deleted" / "c").exists()
    assert prune(root, now=NOW, older_than=2 * DAY) == expected
    assert session_names(root) == ["a"]
    assert not (root / ".deleted").exists()  # left by a prune that was killed


def test_only_sessions_exported_after_their_last_change_are_deleted_on_request(tmp_path: Path) -> None:
    root = dataset(tmp_path, exported=9, never=8, labelled=7, recovered=6)
    for name in ("exported", "labelled", "recovered"):
        mark_exported(root / "sessions" / name, "lerobot", tmp_path / "out", NOW - 3 * DAY)
    labelled = Session.open(root / "sessions" / "labelled")
    labelled.write_hand_labels([LabelSpan(0, ms, 0, "slip")], based_on=0)
    os.utime(labelled.folder / "labels" / "000001.json", ns=(NOW - 2 * DAY, NOW - 2 * DAY))
    os.utime(root / "sessions" / "recovered" / "session.json", ns=(NOW - 2 * DAY, NOW - 2 * DAY))
    found = prune(root, now=NOW, older_than=DAY, keep_unexported=True)
    assert {each.session: each.kept for each in found} == {
        "exported": "",
        "never": "is not exported",
        "labelled": "is not exported",
        "recovered": "is not exported",
    }
    assert session_names(root) == ["labelled", "never", "recovered"]


def test_a_session_is_kept_while_it_is_recorded_and_until_it_is_recovered(tmp_path: Path) -> None:
    async def main() -> None:
        sink = Dataset(tmp_path)
        await sink.open(new_run("live"))
        await sink.write(new_batch(Touch, 50))
        folder = tmp_path / "sessions" / "live"
        [found] = prune(tmp_path, now=NOW**2, older_than=0)
        assert found.kept == "is being recorded"
        await asyncio.sleep(0.2)  # until the rows are in the journal
        shutil.copytree(folder, folder.with_name("killed"))
        await sink.close()

    asyncio.run(main())
    found = {each.session: each.kept for each in prune(tmp_path, now=NOW**2, older_than=0)}
    assert found == {"live": "", "killed": "needs a recovery: run slipflow recover"}
    recover(tmp_path / "sessions" / "killed")
    assert [each.kept for each in prune(tmp_path, now=NOW**2, older_than=0)] == [""]


def test_a_killed_replay_and_unreadable_sessions_are_kept(tmp_path: Path) -> None:
    root = dataset(tmp_path, broken=9, damaged=8, linked=7, replay=6)
    sessions = root / "sessions"
    (sessions / "broken" / "session.json").write_text("{}")
    (sessions / "damaged" / "MANIFEST.json").write_text("{}")
    (sessions / "linked" / "extra").symlink_to("/etc")
    about = json.loads((sessions / "replay" / "session.json").read_text())
    for name in ("end", "end_ns", "check"):
        del about[name]
    (sessions / "replay" / "session.json").write_text(json.dumps(about))
    found = {each.session: each.kept for each in prune(root, now=NOW**2, older_than=0)}
    assert found.pop("replay") == "needs a recovery: run slipflow recover"
    assert len(found) == 3
    assert all(str(sessions / name) in kept for name, kept in found.items())
    assert len(session_names(root)) == 4


@pytest.mark.parametrize("dry_run", [False, True])
def test_a_link_in_the_place_of_the_deleted_sessions_is_refused(tmp_path: Path, *, dry_run: bool) -> None:
    root = dataset(tmp_path / "data", old=31)
    (tmp_path / "elsewhere").mkdir()
    (root / ".deleted").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=r"\.deleted: is a link, must be a folder: delete the link"):
        prune(root, now=NOW, older_than=30 * DAY, dry_run=dry_run)
    assert session_names(root) == ["old"]
    assert not list((tmp_path / "elsewhere").iterdir())


def test_a_folder_that_is_no_dataset_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sessions" / "one").mkdir(parents=True)
    (tmp_path / "sessions" / "one" / "session.json").write_text("{}")
    with pytest.raises(InputError):
        prune(tmp_path, now=NOW, older_than=0)


def test_the_command_names_what_it_deletes_and_keeps(tmp_path: Path) -> None:
    session = record(tmp_path / "data", [new_samples(np.arange(60) * 10 * ms)], "one")
    record(tmp_path / "data", [new_batch(Touch, 50)], "two")
    assert not is_exported(session.folder)
    words = ("prune", "data", "--older-than", "0s", "--keep-unexported")
    done = slipflow("export", "data/sessions/one", "out", "--to", "lerobot", cwd=tmp_path)
    assert done.returncode == 0, done
    assert is_exported(session.folder)
    lines = slipflow(*words, "--dry-run", cwd=tmp_path).stdout.splitlines()
    assert lines[0].startswith("would delete one (0.")
    assert lines[0].endswith("because of its age")
    assert lines[1].startswith("kept two (")
    assert lines[1].endswith("is not exported")
    assert lines[2].startswith("1 session, 0.")
    found = json.loads(slipflow(*words, "--json", cwd=tmp_path).stdout)["sessions"]
    assert [(each["session"], each["kept"]) for each in found] == [("one", ""), ("two", "is not exported")]
    assert session_names(tmp_path / "data") == ["two"]
    assert "must be a size with its unit" in error("prune", "data", "--larger-than", "200", cwd=tmp_path)
