import asyncio
from pathlib import Path

import numpy as np

from flows.relabel import relabel
from flows.run.replay_runner import ReplayRunner
from operators import Labelled, Slips
from operators.batch import concat
from storage import Session


def replayed(source: Path, out: Path, speed: float) -> Session:
    folder = min((source / "sessions").iterdir())
    flow = relabel(str(out), speed=speed, delay=0)
    asyncio.run(ReplayRunner(flow, Session.open(folder), "again").execute())
    return Session.open(out / "sessions" / "again")


def test_a_changed_label_changes_the_samples_and_keeps_the_counts(tiny: Path, tmp_path: Path) -> None:
    before, after = (
        concat(Labelled, list(replayed(tiny, tmp_path / str(speed), speed).read(Labelled, 0)))
        for speed in (0.003, 0.2)
    )
    assert np.array_equal(before.counts, after.counts)
    assert (before.label == 1).sum() > (after.label == 1).sum()


def test_relabelling_writes_derived_streams_only(tiny: Path, tmp_path: Path) -> None:
    session = replayed(tiny, tmp_path, 0.003)
    assert set(session.tables) == {"samples", "slips", "episodes", "truth"}
    assert session.fingers(Slips) == (0,)
