import asyncio
from pathlib import Path

import numpy as np

from flows.relabel import relabel
from flows.run.replay_runner import ReplayRunner
from operators import Labelled, Slips
from operators.batch import concat
from storage import Session


def recorded(dataset: Path) -> Session:
    return Session.open(min((dataset / "sessions").iterdir()))


def replayed(source: Path, out: Path, speed: float) -> Session:
    flow = relabel(str(out), speed=speed, delay=0)
    asyncio.run(ReplayRunner(flow, recorded(source), "again").execute())
    return Session.open(out / "sessions" / "again")


def test_a_changed_label_changes_the_samples_and_keeps_the_counts(tiny: Path, tmp_path: Path) -> None:
    sessions = [replayed(tiny, tmp_path / str(speed), speed) for speed in (0.003, 0.2)]
    first, before, after = (
        concat(Labelled, list(session.read(Labelled, 0))) for session in (recorded(tiny), *sessions)
    )
    assert np.array_equal(first.label, before.label)
    assert np.array_equal(before.counts, after.counts)
    assert (before.label == 1).sum() > (after.label == 1).sum()
    assert set(sessions[0].tables) == {"samples", "slips", "episodes", "truth"}, "derived streams only"
    assert sessions[0].fingers(Slips) == (0,)
