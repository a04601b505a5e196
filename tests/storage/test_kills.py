"""A replay or recovery killed at any step leaves a correct session; `tests.faults` kills recordings."""

from functools import partial
from pathlib import Path
from shutil import copytree
from typing import Any

import pytest

from flows.run.session_output import new_session
from operators.batch import EVERY, Batch, Episodes, Motion, Slips, Touch, ms
from operators.errors import EndpointError
from storage import Session, recover, verify
from tests.storage.disk_steps import ROWS, each_kind, end_at, observed, record, steps_of
from tests.storage.made import leave, new_run, rows, session_names, side_by_side

BATCHES = side_by_side(5)
STREAMS: list[tuple[type[Batch], int]] = [(Touch, 0), (Motion, EVERY), (Slips, 0), (Episodes, EVERY)]


def numbers(session: Session, kind: type[Batch], finger: int) -> list[int]:
    return [time // (10 * ms) for batch in session.read(kind, finger) for time in batch.time.tolist()]


def replay(root: Path) -> None:
    with new_session(root, "one") as scratch:
        record(scratch, new_run(live=False), [])


def test_a_replay_killed_at_any_step_is_whole_or_absent(tmp_path: Path) -> None:
    steps, complete = steps_of(partial(replay, tmp_path / "whole")), 0
    assert {"fsync part", "fsync manifest", "fsync session", "rename one"} <= set(steps)
    for number in [*each_kind(steps, every=20), steps.index("rename one") + 1]:
        place = tmp_path / str(number)
        end_at(number, partial(replay, place))
        if not (place / "sessions/one").exists():
            continue
        complete += 1
        session = Session.open(place)
        assert (session.about["complete"], verify(place).code) == (True, 0), steps[number]
        for kind, finger in STREAMS:
            assert numbers(session, kind, finger) == list(range(ROWS)), steps[number]
    assert complete


def test_a_replay_whose_fsync_failed_is_absent(tmp_path: Path) -> None:
    def fail(step: str) -> None:
        if step == "fsync part":
            raise OSError(5, "Input/output error")

    with observed(fail), pytest.raises(EndpointError, match="Input/output error"):
        replay(tmp_path)
    assert session_names(tmp_path) == []


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
