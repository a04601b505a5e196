"""A replay or recovery killed at any step leaves a correct session; `tests.faults` kills recordings."""

from functools import partial
from pathlib import Path
from shutil import copytree
from typing import Any

from operators.batch import EVERY, Batch, Episodes, Motion, Slips, Touch, ms
from storage import Session, recover, verify
from tests.storage.disk_steps import ROWS, each_kind, end_at, record, steps_of
from tests.storage.made import leave, new_run, rows, side_by_side

BATCHES = side_by_side(5)
STREAMS: list[tuple[type[Batch], int]] = [(Touch, 0), (Motion, EVERY), (Slips, 0), (Episodes, EVERY)]


def numbers(session: Session, kind: type[Batch], finger: int) -> list[int]:
    return [time // (10 * ms) for batch in session.read(kind, finger) for time in batch.time.tolist()]


def test_a_replay_killed_at_any_step_is_whole_or_says_that_it_is_not(tmp_path: Path) -> None:
    replay = new_run(live=False)
    steps = steps_of(partial(record, tmp_path / "whole", replay, []))
    for number in each_kind(steps):
        place = tmp_path / str(number)
        end_at(number, partial(record, place, replay, []))
        folder = place / "sessions/one"
        if not (folder / "session.json").exists():
            continue
        before = Session.open(place).about["complete"]
        assert verify(place).code == (0 if before else 3), steps[number]
        assert bool(recover(folder).lost) != (before or not list(folder.glob("*/*.parquet"))), steps[number]
        session = Session.open(place)
        assert session.about["complete"] is before
        for kind, finger in STREAMS:
            found = numbers(session, kind, finger)
            assert found == list(range(len(found))), steps[number]
            assert len(found) == ROWS or not before, steps[number]


def test_a_killed_recovery_is_carried_out_by_the_next(tmp_path: Path) -> None:
    left = leave(tmp_path / "data", new_run(), BATCHES)
    copytree(left, tmp_path / "whole")
    steps = steps_of(partial(recover, tmp_path / "whole"))
    assert {"unlink segment", "rmdir journal", "replace new part"} <= set(steps)
    for number in range(len(steps)):
        place = tmp_path / str(number)
        copytree(left, place)
        end_at(number, partial(recover, place))
        recover(place)
        assert rows(place, BATCHES) == [25] * 5, steps[number]
        about: Any = Session.open(place).about
        assert about["recovered"]["rows"] == {"touch": 10, "motion": 5, "samples": 5, "slips": 25}
