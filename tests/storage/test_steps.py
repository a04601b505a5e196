"""Whatever is killed at any of its steps, what is left can be read, and is right."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from operators.batch import EVERY, Batch, Episodes, Motion, Slips, Touch, ms
from storage import Session, recover, verify
from storage.steps import STEPS
from tests.storage.made import leave, new_run, rows, side_by_side

SCRIPT = Path(__file__).with_name("kill_points.py")
ROOT = Path(__file__).parents[2]
BATCHES = side_by_side(5)


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


def test_a_replay_killed_at_any_step_is_whole_or_says_that_it_is_not(tmp_path: Path) -> None:
    counts = kill("replay", tmp_path)
    reached = {step for step in STEPS if counts[step]}
    assert reached == {
        *(
            f"{each} {what}"
            for each in ("write", "rename", "sync")
            for what in ("part", "session", "manifest")
        ),
        *(f"{each} dataset" for each in ("write", "rename", "sync", "sync name of")),
        "sync name of session",
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
        taken = len((place / ".taken").read_bytes())
        if not (place / "sessions/one/session.json").exists():
            assert taken == 0
            continue
        assert recover(place / "sessions/one").complete, place
        session = Session.open(place)
        for kind, finger in ((Touch, 0), (Motion, -1), (Slips, 0)):
            found = numbers(session, kind, finger)
            assert found == list(range(len(found))), place
            assert len(found) >= taken - 10, place
        strokes = [number // 4 for number in numbers(session, Episodes, EVERY)]
        assert strokes == list(range(len(strokes))), place
        assert len(strokes) >= taken // 4 - 10, place
        assert verify(place).code in {0, 3}, place
        assert list(place.rglob("*.tmp")) == list(place.glob("*.tmp")), place


def test_a_recovery_killed_at_any_step_is_carried_out_by_the_next(tmp_path: Path) -> None:
    (tmp_path / "killed").mkdir()
    counts = kill("recover", leave(tmp_path / "data", new_run(), BATCHES), tmp_path / "killed")
    reached = {step for step in STEPS if counts[step]}
    assert reached >= {
        f"{each} {what}" for each in ("write", "rename") for what in ("part", "session", "manifest")
    }
    assert reached >= {"delete segment", "delete journal"}
    for place in (tmp_path / "killed").iterdir():
        recover(place)
        assert rows(place, BATCHES) == [25] * 5, place
        about: Any = Session.open(place).about
        assert about["recovered"]["rows"] == {"touch": 10, "motion": 5, "samples": 5, "slips": 25}, place
