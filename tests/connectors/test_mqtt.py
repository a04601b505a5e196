import asyncio
import json
import signal
import subprocess
import sys
from collections.abc import Awaitable, Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator, validate

from connectors import Event, Mqtt, link, mqtt
from connectors.events import Fault
from connectors.link import Link
from connectors.testing import Received, TestBroker, TestListener
from operators.batch import Clocks, Faults, Slips, ms, s
from operators.errors import EndpointError, ParameterError
from operators.health import FaultKind
from operators.ports import Run, SinkStatus, SourceStatus

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]

SCHEMA = json.loads(files("connectors").joinpath("slip-event.schema.json").read_text(encoding="utf-8"))
RIG = "slip/v1/lab/rig"
NOW = 100 * s  # what the clock of the run shows


def slips(*states: int, finger: int = 0, probability: float = 0.9) -> Slips:
    """Rows 10 ms apart, the first 30 ms before now."""
    time = NOW - 30 * ms + 10 * ms * np.arange(len(states))
    return Slips(time, np.array(states, np.int8), time, np.full(len(states), probability), finger=finger)


def fault(barometer: int, kind: FaultKind, *, begins: bool) -> Faults:
    columns = np.array([barometer], np.int8), np.array([kind], np.int8), np.array([begins])
    return Faults(np.array([NOW]), *columns, finger=0)


def use(sink: Mqtt, run: Run, body: Callable[[], Awaitable[None]]) -> None:
    """Do something while the sink is open."""

    async def main() -> None:
        await sink.open(run)
        try:
            await body()
        finally:
            await sink.close()

    asyncio.run(main())


def event(listener: TestListener, finger: str = "0") -> Event:
    """The next event, checked against the schema by an independent validator."""
    received = listener.next(f"{RIG}/{finger}/event")
    assert not received.retained
    validate(json.loads(received.payload), SCHEMA, Draft202012Validator)
    return Event.decode(received.payload.encode())


def read(received: Received) -> Any:  # noqa: ANN401 - JSON
    return json.loads(received.payload)


def test_events_arrive_in_order_and_satisfy_the_schema(broker: TestBroker, run: Run) -> None:
    listener = broker.listen(f"{RIG}/+/event")
    sink = Mqtt(broker.url, model={"id": "tcn", "sha256": "0f" * 32}, threshold=0.5, consecutive=2)

    async def body() -> None:
        await sink.write(slips(1, 0))
        await sink.write(slips(1, finger=2, probability=float("nan")))

    use(sink, run, body)
    first = Event(
        "lab",
        "rig",
        "0",
        "run1",
        1,
        onset=True,
        time=NOW - 30 * ms,
        probability=0.9,
        latency=30,
        threshold=0.5,
        consecutive=2,
        model="tcn",
        sha256="0f" * 32,
    )
    second = replace(first, seq=2, onset=False, time=NOW - 20 * ms, latency=20)
    third = replace(first, seq=3, finger="2", probability=None)
    assert [event(listener), event(listener), event(listener, "2")] == [first, second, third]


def test_what_a_late_subscriber_must_know_is_retained(broker: TestBroker, run: Run) -> None:
    run.describe["touch"] = {"sensor": "TakkTile", "rate_hz": 100.0, "noise": float("nan")}
    found: dict[str, Any] = {}

    async def body() -> None:
        await sink.write(slips(1, 0, 1))
        listener = broker.listen("slip/#")
        for _ in range(5):
            received = listener.next()
            assert received.retained
            found[received.topic.removeprefix(f"{RIG}/")] = read(received)

    sink = Mqtt(broker.url)
    use(sink, run, body)
    health = found.pop("health")
    assert health["epoch"] == "run1"
    version = found["status"].pop("version")
    assert version[0].isdigit()
    assert found == {
        "status": {"state": "online", "epoch": "run1", "since": "1970-01-01T00:01:40.000000000Z"},
        "info": {
            "flow": "live",
            "epoch": "run1",
            "sources": {"touch": {"sensor": "TakkTile", "rate_hz": 100.0, "noise": None}},
            "model": {"id": "unknown", "sha256": None},
            "threshold": None,
            "consecutive": None,
            "units": {"p": "1", "sample_time_ns": "ns", "latency_ms": "ms"},
        },
        "head": {"epoch": "run1", "last_seq": 3},
        "0/state": {"slip": True, "p": 0.9, "since": "1970-01-01T00:01:39.990000000Z", "seq": 3},
    }


def test_leaving_in_order_says_offline_and_when(broker: TestBroker, run: Run, links: list[Link]) -> None:
    async def body() -> None:
        pass

    listener = broker.listen(f"{RIG}/status")
    use(Mqtt(broker.url), run, body)
    assert not links[0].alive
    assert read(listener.next())["state"] == "online"
    farewell = read(listener.next())
    assert (farewell["state"], farewell["since"]) == ("offline", "1970-01-01T00:01:40.000000000Z")


def test_faults_mark_the_events_while_they_last(broker: TestBroker, run: Run) -> None:
    listener = broker.listen(f"{RIG}/+/event")
    sink = Mqtt(broker.url)

    async def body() -> None:
        await sink.write(fault(3, FaultKind.STUCK, begins=True))
        await sink.write(fault(1, FaultKind.DEAD, begins=True))
        await sink.write(slips(1))
        await sink.write(slips(1, finger=1))
        await sink.write(fault(3, FaultKind.STUCK, begins=False))
        await sink.write(slips(0))

    use(sink, run, body)
    assert event(listener).degraded == (Fault(1, "dead"), Fault(3, "stuck"))
    assert event(listener, "1").degraded == ()
    assert event(listener).degraded == (Fault(1, "dead"),)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_broker_that_comes_back_gets_the_event_and_all_that_it_should_retain(
    broker: TestBroker, run: Run, number: signal.Signals
) -> None:
    sink = Mqtt(broker.url)

    async def body() -> None:
        await sink.write(slips(1))
        batch = slips(0)
        broker.stop(number)
        for _ in range(2):
            with pytest.raises(EndpointError):
                await sink.write(batch)
        broker.start()
        listener = broker.listen("slip/#")
        await sink.write(batch)
        assert event(listener).seq == 2
        listener = broker.listen("slip/#")
        found = {received.topic: read(received) for received in (listener.next() for _ in range(5))}
        assert found[f"{RIG}/status"]["state"] == "online"
        assert found[f"{RIG}/0/state"]["slip"] is False
        assert found[f"{RIG}/head"] == {"epoch": "run1", "last_seq": 2}
        assert {f"{RIG}/info", f"{RIG}/health"} < set(found)

    use(sink, run, body)


def test_a_batch_is_continued_where_it_failed(
    broker: TestBroker, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    sink, send, failed = Mqtt(broker.url), Link.send, list[str]()

    async def fail_once(self: Link, topic: str, payload: bytes, **options: Any) -> None:  # noqa: ANN401
        if b'"seq":2,"epoch"' in payload and not failed:
            failed.append(topic)
            raise EndpointError("broker", "refuses")
        await send(self, topic, payload, **options)

    monkeypatch.setattr(Link, "send", fail_once)

    async def body() -> None:
        batch = slips(1, 0, 1)
        with pytest.raises(EndpointError):
            await sink.write(batch)
        await sink.write(batch)

    listener = broker.listen(f"{RIG}/+/event")
    use(sink, run, body)
    assert failed
    assert [event(listener).seq for _ in range(3)] == [1, 2, 3]


def test_a_batch_that_is_given_up_leaves_a_gap_in_the_numbers(broker: TestBroker, run: Run) -> None:
    sink = Mqtt(broker.url)

    async def body() -> None:
        broker.stop()
        with pytest.raises(EndpointError):
            await sink.write(slips(1, 0))
        broker.start()
        listener = broker.listen(f"{RIG}/+/event")
        await sink.write(slips(1))
        assert event(listener).seq == 3

    use(sink, run, body)


def test_the_numbers_begin_again_with_each_run(broker: TestBroker, run: Run) -> None:
    listener = broker.listen(f"{RIG}/+/event")
    sink = Mqtt(broker.url)

    async def body() -> None:
        await sink.write(slips(1))

    use(sink, run, body)
    use(sink, Run("run2", "live", run.clock, 0), body)
    assert [event(listener).identifier for _ in range(2)] == ["run1-1", "run2-1"]


def test_health_is_published_again_and_again(
    broker: TestBroker, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt, "HEALTH_EVERY", 0.02)
    run.sources["touch"] = SourceStatus(rows=1000, up=True, newest=NOW - 5 * ms)
    run.sinks["dataset"] = SinkStatus(rows=990, dropped=10, error="disk full")
    sink = Mqtt(broker.url)

    async def body() -> None:
        await sink.write(fault(3, FaultKind.STUCK, begins=True))
        offset, drift, residual = np.array([3 * s]), np.array([-5e-05]), np.array([0.004])
        await sink.write(Clocks(np.array([NOW]), offset, drift, residual))
        listener = broker.listen(f"{RIG}/health")
        reports = [read(await asyncio.to_thread(listener.next)) for _ in range(3)]
        assert reports[-1]["sources"]["touch"]["rows"] == 1000
        assert reports[-1]["sinks"]["dataset"]["error"] == "disk full"
        assert reports[-1]["degraded"] == {"0": [{"barometer": 3, "kind": "stuck"}]}
        clock = {"time_ns": NOW, "offset_ms": 3000.0, "drift_ppm": -50.0, "residual_ms": 4.0}
        assert reports[-1]["clock"] == clock

    use(sink, run, body)


def test_without_any_event_the_connection_is_made_again_and_its_loss_logged_once(
    broker: TestBroker, run: Run, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(mqtt, "HEALTH_EVERY", 0.01)
    connect, failures = Link.connect, asyncio.Semaphore(0)

    async def counted(self: Link) -> None:
        try:
            await connect(self)
        except EndpointError:
            failures.release()
            raise

    monkeypatch.setattr(Link, "connect", counted)

    async def body() -> None:
        broker.stop()
        for _ in range(3):
            await failures.acquire()
        await asyncio.to_thread(broker.start)
        listener = await asyncio.to_thread(broker.listen, f"{RIG}/status")
        assert read(await asyncio.to_thread(listener.next))["state"] == "online"

    use(Mqtt(broker.url), run, body)
    assert len(caplog.messages) == 1
    assert caplog.messages[0].startswith(f"{broker.url}: ")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_run_ends_in_peace_though_the_broker_is_gone_or_hangs(
    broker: TestBroker, run: Run, number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "TIMEOUT", 0.1)

    async def body() -> None:
        assert broker.process
        broker.process.send_signal(number)

    use(Mqtt(broker.url), run, body)


PUBLISH_AND_WAIT = """
import asyncio, sys, time
from connectors import Mqtt
from operators.ports import Run

class Clock:
    now = time.time_ns

async def main(url, rig):
    await Mqtt(url, rig=rig).open(Run("killed", "live", Clock, 0))
    print("open", flush=True)
    await asyncio.sleep(3600)

asyncio.run(main(*sys.argv[1:]))
"""


def test_a_killed_run_is_offline_soon_but_not_if_another_has_taken_its_place(
    broker: TestBroker, run: Run
) -> None:
    command = [sys.executable, "-c", PUBLISH_AND_WAIT, broker.url]
    started = [
        subprocess.Popen([*command, rig], stdout=subprocess.PIPE, text=True) for rig in ("rig", "lost")
    ]
    listener = broker.listen("slip/v1/lab/+/status")
    for process in started:
        with process as opened:
            assert opened.stdout
            assert opened.stdout.readline() == "open\n"
            opened.kill()

    async def body() -> None:
        while read(await asyncio.to_thread(listener.next, "slip/v1/lab/lost/status"))["state"] != "offline":
            pass
        status = broker.listen(f"{RIG}/status").next()
        assert read(status)["state"] == "online"
        assert read(status)["epoch"] == "run1"

    use(Mqtt(broker.url), run, body)


def test_a_connection_that_is_back_soon_was_never_offline(
    broker: TestBroker, run: Run, links: list[Link]
) -> None:
    sink, lost = Mqtt(broker.url), Mqtt(broker.url, rig="lost")
    listener = broker.listen("slip/v1/lab/+/status")

    async def body() -> None:
        await lost.open(run)
        for each in list(links):
            each.drop()
        await sink.write(slips(1))
        seen = list[Received]()
        while not seen or (seen[-1].topic, read(seen[-1])["state"]) != ("slip/v1/lab/lost/status", "offline"):
            seen.append(await asyncio.to_thread(listener.next))
        assert {read(status)["state"] for status in seen if status.topic == f"{RIG}/status"} == {"online"}
        assert read(seen[-1])["since"] is None  # the broker speaks for it
        await lost.close()

    use(sink, run, body)


def test_a_run_that_cannot_connect_does_not_begin(broker: TestBroker, run: Run) -> None:
    broker.stop()
    with pytest.raises(EndpointError, match=f"^{broker.url}: cannot connect: Connection refused$"):
        asyncio.run(Mqtt(broker.url).open(run))


def test_a_run_that_may_not_publish_does_not_begin(tmp_path: Path, run: Run, links: list[Link]) -> None:
    rights = tmp_path / "rights"
    rights.write_text("topic read #\n")
    broker = TestBroker(tmp_path, "allow_anonymous true", f"acl_file {rights}")
    try:
        with pytest.raises(EndpointError, match=f"refuses to publish {RIG}/status: Not authorized$"):
            asyncio.run(Mqtt(broker.url).open(run))
        assert not links[0].alive
    finally:
        broker.close()


def test_an_event_that_the_broker_refuses_is_an_error_and_the_connection_stays(
    tmp_path: Path, run: Run, links: list[Link]
) -> None:
    rights = tmp_path / "rights"
    rights.write_text(
        "".join(f"topic readwrite {RIG}/{name}\n" for name in ("status", "info", "head", "health"))
    )
    broker = TestBroker(tmp_path, "allow_anonymous true", f"acl_file {rights}")
    sink = Mqtt(broker.url)

    async def body() -> None:
        with pytest.raises(EndpointError, match=f"refuses to publish {RIG}/0/event: Not authorized$"):
            await sink.write(slips(1))
        assert len(links) == 1
        assert links[0].alive

    try:
        use(sink, run, body)
    finally:
        broker.close()


def test_two_sinks_of_one_rig_share_a_place() -> None:
    assert (
        Mqtt("mqtt://localhost").place
        == Mqtt("mqtt://localhost:1883").place
        == f"mqtt://localhost:1883/{RIG}"
    )
    assert Mqtt("mqtt://localhost").place != Mqtt("mqtt://localhost", rig="other").place


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("url", "localhost"),
        ("site", "a/b"),
        ("rig", "+"),
        ("model", {"sha256": "0f"}),
        ("model", {"sha256": "G" * 64}),
        ("model", {"id": "a\nb"}),
        ("model", {"id": "tcn", "version": "1"}),
        ("threshold", 1.5),
        ("threshold", float("nan")),
        ("consecutive", 0),
    ],
)
def test_a_parameter_that_no_event_could_carry_is_refused(name: str, value: Any) -> None:  # noqa: ANN401
    parameters: dict[str, Any] = {"url": "mqtt://localhost", name: value}
    with pytest.raises(ParameterError, match=f"^Mqtt: {name} is "):
        Mqtt(**parameters)
