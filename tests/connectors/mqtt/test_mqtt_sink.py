import asyncio
import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from connectors import Event, Mqtt
from connectors.events import CONTENT_TYPE, Fault, Model
from connectors.mqtt import broker_link as link
from connectors.mqtt import sender
from connectors.mqtt.broker_link import Link
from connectors.mqtt.mqtt_sink import health
from operators.batch import Slips, ms, s
from operators.errors import EndpointError
from operators.health import FaultKind
from operators.ports import Run, SourceStatus
from tests.connectors.mqtt.broker_process import Received, TestBroker, TestListener
from tests.connectors.mqtt.made import opened, slips
from tests.connectors.web.reading import fault
from tests.inside import inside
from tests.waiting import until

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]

RIG = "slip/v1/lab/rig"
NOW = 100 * s  # what the clock of the run shows


def event(listener: TestListener, finger: str = "0") -> Event:
    received = listener.next(f"{RIG}/{finger}/event")
    assert (received.retained, received.content_type) == (False, CONTENT_TYPE)
    return Event.decode(received.payload.encode())


def read(received: Received) -> Any:
    return json.loads(received.payload)


async def sent(sink: Mqtt) -> None:
    """Wait until the broker has all events."""
    await until(lambda: not inside(sink, "_outbox").waiting)


async def test_events_arrive_in_order(broker: TestBroker, run: Run) -> None:
    listener = broker.listen(f"{RIG}/+/event")
    rule: Any = {"threshold": np.float64(0.5), "consecutive": np.int64(2)}  # as of a study
    sink = Mqtt(broker.url, rig="rig", model={"id": "tcn", "sha256": "0f" * 32}, **rule)
    async with opened(sink, run):
        await sink.write(slips(1, 0))
        await sink.write(slips(1, finger=2, probability=float("nan")))
    found = [event(listener), event(listener), event(listener, "2")]
    first = Event(
        site="lab",
        rig="rig",
        finger="0",
        epoch=found[0].epoch,
        seq=1,
        state="onset",
        time=NOW - 30 * ms,
        probability=0.9,
        latency=30,
        threshold=0.5,
        consecutive=2,
        model=Model(id="tcn", sha256="0f" * 32),
        session="run1",
    )
    second = replace(first, seq=2, state="end", time=NOW - 20 * ms, latency=20)
    third = replace(first, seq=3, finger="2", probability=None)
    assert found == [first, second, third]


async def test_a_regular_end_publishes_offline(broker: TestBroker, run: Run, links: list[Link]) -> None:
    listener = broker.listen(f"{RIG}/status")
    async with opened(Mqtt(broker.url, rig="rig"), run):
        pass
    assert not links[0].alive
    assert read(listener.next())["state"] == "online"
    farewell = read(listener.next())
    assert (farewell["state"], farewell["since"]) == ("offline", "1970-01-01T00:01:40.000000000Z")


async def test_events_and_health_tell_which_faults_last(
    broker: TestBroker, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sender, "HEALTH_EVERY", 0.02)
    listener = broker.listen(f"{RIG}/+/event")
    sink = Mqtt(broker.url, rig="rig")
    async with opened(sink, run):
        await sink.write(fault(NOW, 3, FaultKind.STUCK))
        await sink.write(fault(NOW, 1, FaultKind.DEAD))
        await sink.write(slips(1))
        await sink.write(slips(1, finger=1))
        await sink.write(fault(NOW, 3, FaultKind.STUCK, begins=False))
        await sink.write(slips(0))
        health = broker.listen(f"{RIG}/health")
        reports = [read(await asyncio.to_thread(health.next)) for _ in range(3)]
    assert event(listener).degraded == (Fault(1, "dead"), Fault(3, "stuck"))
    assert event(listener, "1").degraded == ()
    assert event(listener).degraded == (Fault(1, "dead"),)
    assert reports[-1]["degraded"] == {"0": [{"barometer": 1, "kind": "dead"}]}


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
async def test_a_restarted_broker_gets_the_pending_events_and_retained_documents(
    broker: TestBroker, run: Run, number: signal.Signals
) -> None:
    sink = Mqtt(broker.url, rig="rig")
    async with opened(sink, run):
        await sink.write(slips(1))
        await sent(sink)
        broker.stop(number)
        for state in (0, 1, 0):
            await sink.write(slips(state))  # no write waits for a broker
        await asyncio.to_thread(broker.start)
        await sent(sink)
        await until(lambda: not inside(sink, "_sender", "_changed"))
        listener = broker.listen("slip/#")
        found = {received.topic: read(received) for received in (listener.next() for _ in range(4))}
    epoch = inside(sink, "_outbox").epoch
    status, state = (found[f"{RIG}/{name}"] for name in ("status", "0/state"))
    assert (status["state"], status["session"], status["epoch"]) == ("online", "run1", epoch)
    assert state == {
        "slip": False,
        "p": 0.9,
        "quality": "good",
        "since": "1970-01-01T00:01:39.970000000Z",
        "epoch": epoch,
        "seq": 4,
    }
    assert found[f"{RIG}/head"] == {"epoch": epoch, "last_seq": 4}
    assert found[f"{RIG}/health"]["outbox"] == {"error": None, "waiting": 0, "refused": []}


async def test_a_fingertips_state_is_that_of_the_run(broker: TestBroker, run: Run, links: list[Link]) -> None:
    def states(*finger: int) -> list[tuple[Any, ...]]:
        found = [read(broker.listen(f"{RIG}/{each}/state").next()) for each in finger]
        return [(each["slip"], each["p"], each["seq"], each["epoch"]) for each in found]

    first, second = Mqtt(broker.url, rig="rig"), Mqtt(broker.url, rig="rig")
    for sink in (first, second):
        run.sink_types[sink.destination] = {Slips: (0, 2)}
    await first.open(run)
    await first.write(slips(1))
    await sent(first)
    epoch = inside(first, "_outbox").epoch
    await until(lambda: not inside(first, "_sender", "_changed"))
    assert states(0, 2) == [(True, 0.9, 1, epoch), (False, None, 0, epoch)]
    inside(first, "_sender", "_sending", "_task").cancel()  # a kill, before the broker has the second event
    await first.write(slips(0, 1))
    links[0].abort()
    await inside(first, "_outbox").close()
    async with opened(second, run):
        await sent(second)
        await until(lambda: not inside(second, "_sender", "_changed"))
        epoch = inside(second, "_outbox").epoch
        assert states(0, 2) == [(False, None, 0, epoch)] * 2
        await second.write(slips(1, finger=2))
        await sent(second)
        await until(lambda: not inside(second, "_sender", "_changed"))
        assert states(2) == [(True, 0.9, 1, epoch)]
    assert states(0, 2) == [(False, None, 0, epoch)] * 2


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
async def test_a_run_ends_without_error_if_the_broker_is_gone_or_hangs(
    broker: TestBroker, run: Run, number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "TIMEOUT", 0.1)
    async with opened(Mqtt(broker.url, rig="rig"), run):
        assert broker.process
        broker.process.send_signal(number)


async def test_a_killed_run_becomes_offline_unless_it_or_another_run_is_back_soon(
    broker: TestBroker, run: Run, links: list[Link], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "WILL_DELAY", 1)
    sinks = {rig: Mqtt(broker.url, rig=rig) for rig in ("rig", "taken-over", "lost")}
    listener = broker.listen("slip/v1/lab/+/status")
    for sink in sinks.values():
        await sink.open(run)
    for rig in ("taken-over", "lost"):
        inside(sinks[rig], "_sender", "_sending", "_task").cancel()  # so that it does not come back
    for each in list(links):
        each.abort()
    again = Mqtt(broker.url, rig="taken-over", outbox=tmp_path / "other.outbox")
    await again.open(Run("again", "live", run.clock, 0))
    await sinks["rig"].write(slips(1))
    seen = list[Received]()
    while not seen or (seen[-1].topic, read(seen[-1])["state"]) != ("slip/v1/lab/lost/status", "offline"):
        seen.append(await asyncio.to_thread(listener.next))
    assert read(seen[-1])["since"] is None  # the broker speaks for it
    assert {read(each)["state"] for each in seen[:-1]} == {"online"}
    assert any(read(each)["session"] == "again" for each in seen)
    for sink in (*sinks.values(), again):
        await sink.close()


def test_a_run_without_rights_to_publish_does_not_start(tmp_path: Path, run: Run, links: list[Link]) -> None:
    rights = tmp_path / "rights"
    rights.write_text("topic read #\n")
    with TestBroker(tmp_path, "allow_anonymous true", f"acl_file {rights}") as broker:
        with pytest.raises(EndpointError, match=f"refuses to publish {RIG}/status: Not authorized; allow"):
            asyncio.run(Mqtt(broker.url, rig="rig").open(run))
        assert not links[0].alive


def test_a_health_report_has_the_state_lag_and_rows_of_each_source(run: Run) -> None:
    run.sources["touch"] = SourceStatus(rows=10, newest=100 * s - 5 * ms, up=True)
    run.sources["motion"], run.sources["force"] = SourceStatus(), SourceStatus(stale=True)
    report: Any = health(run)
    assert report["time_ns"] == NOW
    silent = {"lag_ms": None, "rows": 0}
    assert report["sources"] == {
        "touch": {"state": "up", "lag_ms": 5, "rows": 10},
        "motion": {"state": "down", **silent},
        "force": {"state": "stale", **silent},
    }
