"""Rehearsal of the section "Backup and restore" of docs/how-to/deploy.md."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from connectors import Event, Mqtt
from operators import Run, Slips
from storage import Dataset, Session
from tests.command import slipflow
from tests.connectors.mqtt.broker_process import TestBroker, TestListener
from tests.inside import inside
from tests.storage.made import new_run
from tests.waiting import until

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]


async def raise_slip(folder: Path, broker: TestBroker, run: Run, *, is_up: bool) -> None:
    """Record and publish one event in a run of its own; if the broker is up, until it has all events."""
    time = np.array([run.clock.now()])
    slips = Slips(time, np.array([1], np.int8), time, np.array([0.9]), finger=0)
    dataset, mqtt = Dataset(folder / "recordings"), Mqtt(broker.url, connect_required=False)
    for sink in (dataset, mqtt):
        await sink.open(run)
        await sink.write(slips)
    if is_up:
        await until(lambda: not inside(mqtt, "_outbox").waiting)
    for sink in (dataset, mqtt):
        await sink.close()


def received(listener: TestListener) -> list[str]:
    """Return the identifiers of the events received since the last call."""
    return [Event.decode(each.payload.encode()).identifier for each in listener.rest()]


async def test_a_restored_copy_sends_unsent_events_again_and_uses_no_number_twice(
    broker: TestBroker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, copy = tmp_path / "slipflow", tmp_path / "backup"
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    broker.stop()
    await raise_slip(folder, broker, new_run("before"), is_up=False)
    shutil.copytree(folder, copy)
    broker.start()
    listener = broker.listen("slip/v1/+/+/0/event")
    await raise_slip(folder, broker, new_run("lost"), is_up=True)
    unsent, lost = received(listener)
    shutil.rmtree(folder)
    shutil.copytree(copy, folder)
    await raise_slip(folder, broker, new_run("after"), is_up=True)
    again, new = received(listener)
    assert again == unsent, "consumers remove it as a duplicate"
    assert new not in {unsent, lost}
    assert slipflow("verify", folder / "recordings").returncode == 0
    sessions = sorted((folder / "recordings" / "sessions").iterdir())
    assert [each.name for each in sessions] == ["after", "before"]
    assert all(sum(map(len, Session.open(each).read(Slips, 0))) == 1 for each in sessions)
