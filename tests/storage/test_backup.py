"""A copy of a session that is being recorded, in the order that docs/how-to/backup.md states."""

from functools import partial
from pathlib import Path
from shutil import copy2, copytree, ignore_patterns

import polars as pl

from operators.batch import ms
from storage import Session, recover
from storage.journal import MAX_WAITING
from tests.storage.disk_steps import STREAMS, each_kind, observed, record, steps_of
from tests.storage.made import new_run

PHASES = (3, 40)  # steps of the disk between the journal and the manifest, and to the other files


def copy(folder: Path, target: Path, phase: int) -> None:
    """Copy the journal, then the manifest, then the other files."""
    target.mkdir(exist_ok=True)
    if phase == 0 and (folder / "journal").exists():
        copytree(folder / "journal", target / "journal", ignore=ignore_patterns("*.tmp"))
    elif phase == 1 and (folder / "MANIFEST.json").exists():
        copy2(folder / "MANIFEST.json", target)
    elif phase == 2:
        ignored = ignore_patterns("*.tmp", "journal", "MANIFEST.json")
        copytree(folder, target, ignore=ignored, dirs_exist_ok=True)


def part_times(folder: Path) -> set[tuple[str, int]]:
    """Return table and time of the rows of all Parquet files."""
    found = set[tuple[str, int]]()
    for path in folder.rglob("*.parquet"):
        table = path.relative_to(folder).as_posix().removeprefix("damaged/").replace("-", "/").split("/")[0]
        found |= {(table, time) for time in pl.read_parquet(path)["time"].to_list()}
    return found


def test_a_copy_of_a_running_recording_has_all_rows_that_were_in_its_journal(tmp_path: Path) -> None:
    steps = steps_of(partial(record, tmp_path / "whole", new_run(), []))
    first = steps.index("pwrite segment")  # the journal exists
    starts = [number for number in each_kind(steps, turns=(1,), every=60) if number > first]
    due = [
        (start + phase * gap, phase, f"{start}-{gap}")
        for start in starts
        for gap in PHASES
        for phase in range(3)
    ]
    reached, copying, taken, before = 0, False, list[int](), dict[str, int]()
    folder = tmp_path / "data/sessions/one"

    def reach(_: str) -> None:
        nonlocal reached, copying
        if copying:  # steps of the copy
            return
        reached, copying = reached + 1, True
        for phase, name in [each[1:] for each in due if each[0] == reached]:
            if phase == 0:
                before[name] = len(taken)
            copy(folder, tmp_path / name, phase)
        copying = False

    with observed(reach):
        record(tmp_path / "data", new_run(), taken)
    for step, phase, name in due:
        if step > reached:  # the recording has ended
            copy(folder, tmp_path / name, phase)
    assert len(before) > 20
    for name, rows in before.items():
        copied = part_times(tmp_path / name)
        done = recover(tmp_path / name)
        assert copied <= part_times(tmp_path / name)  # a part that is newer than the manifest is set aside
        assert not done.lost, (name, done)
        session = Session.open(tmp_path / name)
        for kind, finger in STREAMS:
            times = [time for batch in session.read(kind, finger) for time in batch.time.tolist()]
            assert times == [number * 10 * ms for number in range(len(times))]
            assert len(times) >= rows - MAX_WAITING
