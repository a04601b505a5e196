"""Files that may not grow for a while: only the recording stops, and it continues by itself."""

import asyncio
import resource
from pathlib import Path

import numpy as np

from flows.graph import Flow
from flows.graph.testing import TestSink
from flows.run.live_runner import LiveRunner
from operators import Slips, Touch, Zero, concat, ms, s
from operators.ports import SinkStatus
from storage import Dataset, Session, verify
from tests.chaos.children import Alternating
from tests.chaos.numbered import Numbered, touch
from tests.storage.made import same

RATE = 400.0  # rows/s


class DatasetOfFew(Dataset):
    """Dataset with a short queue, so that rows are dropped."""

    capacity = 100  # batches
    part_span = 300 * ms


async def run(flow: Flow, alerts: TestSink) -> tuple[SinkStatus, str, int]:
    """Let no file grow for 1 s; return the status of the recorder, and the error and alerts of that time."""
    runner, limits = LiveRunner(flow, "full"), resource.getrlimit(resource.RLIMIT_FSIZE)
    running = asyncio.create_task(runner.execute())
    await asyncio.sleep(0.7)
    before, status = len(alerts.rows(Slips, 0)), runner.run.sinks["datasetoffew"]
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1, limits[1]))
        await asyncio.sleep(1.0)
        error, given = status.error, len(alerts.rows(Slips, 0)) - before
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    await asyncio.sleep(1.5)
    assert not status.error
    runner.stop()
    await running
    return status, error, given


def test_a_full_disk_stops_only_the_recording_which_continues_when_there_is_room(tmp_path: Path) -> None:
    produced, alerts, flow = list[int](), TestSink(), Flow("full")
    touched = flow.source(Numbered(Touch, touch, RATE, produced.append), "touch").to(DatasetOfFew(tmp_path))
    (touched | Zero(500) | Alternating()).to(alerts)
    status, error, given = asyncio.run(run(flow, alerts))
    session = tmp_path / "sessions" / "full"
    rows = concat(Touch, list(Session.open(session).read(Touch, 0)))
    numbers = np.rint((rows.time - rows.time[0]) * RATE / s).astype(np.int64)
    same(rows, touch(numbers, rows.time))
    assert (np.diff(numbers) > 0).all()
    assert numbers[-1] + 1 == produced[-1] == len(rows) + status.dropped == len(alerts.rows(Slips, 0))
    assert given
    assert "too large" in error, error
    assert verify(session).code == 3
