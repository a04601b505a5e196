"""Files that may not grow for a while: only the recording stops, and it continues by itself."""

import asyncio
import resource
from pathlib import Path

import numpy as np

from flows.graph import Flow
from flows.graph.testing import TestSink
from flows.run.live_runner import LiveRunner
from operators import Touch, concat, ms, s
from operators.ports import SinkStatus
from storage import Dataset, Session, verify
from tests.chaos.numbered import Numbered, touch
from tests.storage.made import same
from tests.waiting import until

RATE = 400.0  # rows/s


class DatasetOfFew(Dataset):
    """Dataset with a short queue, so that rows are dropped."""

    capacity = 100  # batches
    part_span = 300 * ms


async def run(flow: Flow, alerts: TestSink) -> tuple[SinkStatus, str]:
    """Let no file grow until rows are dropped; return the status of the recorder, and its error then."""
    runner, limits = LiveRunner(flow, "full"), resource.getrlimit(resource.RLIMIT_FSIZE)
    running = asyncio.create_task(runner.execute())
    await until(lambda: len(alerts.written) > RATE / 4)
    before, status = len(alerts.written), runner.run.sinks["datasetoffew"]
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1, limits[1]))
        await until(lambda: bool(status.error and status.dropped) and len(alerts.written) > before)
        error = status.error
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    stored = status.rows
    await until(lambda: not status.error and status.rows > stored)
    runner.stop()
    await running
    return status, error


def test_a_full_disk_stops_only_the_recording_which_continues_when_there_is_room(tmp_path: Path) -> None:
    produced, alerts, flow = list[int](), TestSink(), Flow("full")
    touched = flow.source(Numbered(Touch, touch, RATE, produced.append), "touch").to(DatasetOfFew(tmp_path))
    touched.to(alerts)
    status, error = asyncio.run(run(flow, alerts))
    session = tmp_path / "sessions" / "full"
    rows = concat(Touch, list(Session.open(session).read(Touch, 0)))
    numbers = np.rint((rows.time - rows.time[0]) * RATE / s).astype(np.int64)
    same(rows, touch(numbers, rows.time))
    assert (np.diff(numbers) > 0).all()
    assert numbers[-1] + 1 == produced[-1] == len(rows) + status.dropped == len(alerts.rows(Touch, 0))
    assert "too large" in error, error
    assert verify(session).code == 3
