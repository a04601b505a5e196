"""docs/reference/mqtt.md and asyncapi.json are the contract that a rig keeps on a real broker; files run."""

import asyncio
import json
import re
import sys
from collections.abc import Awaitable, Callable
from math import nan
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar, Self
from unittest.mock import MagicMock

import pytest
from jsonschema import Draft7Validator

from connectors import Consumer, Event, Mqtt
from connectors.events import encode
from connectors.mqtt.gap_replay import GapAnswer, GapRequest
from operators.batch import ms
from operators.health import FaultKind
from operators.ports import Run, SinkStatus, SourceStatus
from tests.asyncapi import DOCUMENT, problems
from tests.connectors.mqtt.broker_process import Received, TestBroker
from tests.connectors.mqtt.made import opened, slips
from tests.connectors.web.reading import fault
from tests.pages import ROOT, block, table
from tests.waiting import until

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]

PAGE = ROOT / "docs" / "reference" / "mqtt.md"
RIG = "slip/v1/lab/rig"


def shown(name: str) -> Any:
    return json.loads(block(PAGE, name))


def topic(row: dict[str, str]) -> str:
    """The topic of a row of the page, of this rig, finger 0 and this client."""
    return f"{RIG}/{row['topic'].strip('`')}".replace("<finger>", "0").replace("<name>", "logger-1")


async def messages(broker: TestBroker, run: Run) -> list[Received]:
    """All messages of a run with a fault, slips and a request for missed events."""
    everything, events = broker.listen("slip/#"), broker.listen(f"{RIG}/+/event", f"{RIG}/replay/logger-1")
    run.sources["touch"] = SourceStatus(rows=1000, up=True, newest=run.clock.now() - 5 * ms)
    run.sinks["dataset"] = SinkStatus(rows=990, dropped=10, error="disk full")
    sink = Mqtt(
        broker.url, rig="rig", model={"id": "tcn", "sha256": "0f" * 32}, threshold=0.777, consecutive=2
    )
    async with opened(sink, run):
        await sink.write(fault(run.clock.now(), 3, FaultKind.STUCK))
        await sink.write(slips(1, 0, 1))
        await sink.write(slips(0, probability=nan))
        event = json.loads((await asyncio.to_thread(events.next)).payload)
        asked = {"epoch": event["data"]["epoch"], "from": 1, "to": 1, "reply_to": f"{RIG}/replay/logger-1"}
        await until(lambda: not sink.waiting)
        await asyncio.to_thread(broker.publish, f"{RIG}/replay/request", json.dumps(asked))
        for _ in range(2):
            await asyncio.to_thread(events.next, f"{RIG}/replay/logger-1")
    return everything.rest()


def test_the_asyncapi_document_follows_its_meta_schema_and_has_the_topics_of_the_page() -> None:
    meta = json.loads((ROOT / "tests" / "asyncapi-3.0.0.schema.json").read_text())
    validator: Any = Draft7Validator(meta)
    assert not [(error.json_path, error.message) for error in validator.iter_errors(DOCUMENT)]
    topics = {}
    for name, operation in DOCUMENT["operations"].items():
        channel, mqtt = DOCUMENT["channels"][name], operation["bindings"]["mqtt"]
        address = channel["address"].replace("{", "<").replace("}", ">")
        retained = "yes" if mqtt["retain"] else "no"
        topics[address] = str(mqtt["qos"]), retained, channel["description"]
    rows = table(PAGE, "## Topics")
    assert topics == {
        f"slip/v1/<site>/<rig>/{row['topic'].strip('`')}": (row["QoS"], row["retained"], row["content"])
        for row in rows
    }


async def test_a_rig_publishes_the_documents_of_the_page(broker: TestBroker, run: Run) -> None:
    received = await messages(broker, run)
    assert not {each.topic: found for each in received if (found := problems(*each[:2]))}
    rows = table(PAGE, "## Topics")
    assert {each.topic for each in received} == {topic(row) for row in rows}
    retained = {each.topic for each in broker.listen(f"{RIG}/#").rest()}
    assert retained == {topic(row) for row in rows if row["retained"] == "yes"}
    newest = {each.topic.removeprefix(f"{RIG}/"): json.loads(each.payload) for each in received}
    assert newest["head"].keys() == shown("head").keys() - {"before"}
    text = " ".join(PAGE.read_text().split())
    [fields] = re.findall(r"`health` has (.*?)\. ", text)
    assert {*re.findall(r"`(\w+)`", fields)} == newest["health"].keys() - {"epoch", "session", "time_ns"}
    event = newest["0/event"]
    assert (event.keys(), event["data"].keys()) == (shown("event").keys(), shown("event")["data"].keys())


@pytest.mark.parametrize("name", ["event", "state", "head", "status", "request", "answer"])
def test_the_examples_of_the_page_are_valid(name: str) -> None:
    level = {"event": "0/event", "state": "0/state", "request": "replay/request", "answer": "replay/me"}
    assert not problems(f"{RIG}/{level.get(name, name)}", block(PAGE, name))
    assert problems(f"{RIG}/{level.get(name, name)}", "{}")


def test_the_examples_of_the_page_are_read_and_written() -> None:
    event = Event.decode(encode(shown("event")))
    assert json.loads(event.encode()) == shown("event")
    GapRequest.decode(encode(shown("request")), "slip/v1/lab/ur10")
    answer = shown("answer")
    missing = tuple((first, last) for first, last in answer["missing"])
    closing = GapAnswer(answer["epoch"], answer["from"], answer["to"], missing)
    assert json.loads(closing.encode()) == answer
    [component] = shown("discovery")["components"].values()
    assert component["state_topic"] in {topic(row) for row in table(PAGE, "## Topics")}


def loaded(name: str) -> ModuleType:
    """A file of the page as a module."""
    module = ModuleType(Path(name).stem)
    exec(block(PAGE, name), vars(module))  # noqa: S102 - ours
    return module


class Entered(Consumer):
    """Says when it is connected."""

    begun: ClassVar[asyncio.Event]

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        self.begun.set()
        return self


async def follow(
    broker: TestBroker, run: Run, work: Callable[[], Awaitable[None]], came: Callable[[], bool]
) -> None:
    """Let `work` follow a rig that raises events on two fingertips once it is connected; wait for them."""
    async with opened(Mqtt(broker.url, rig="rig"), run) as sink:
        Entered.begun = asyncio.Event()
        working = asyncio.ensure_future(work())
        await Entered.begun.wait()
        await sink.write(slips(1, 0))
        await sink.write(slips(1, finger=2))
        await until(came)
        working.cancel()
        await asyncio.wait([working])


async def test_the_consumer_prints_each_event(
    broker: TestBroker,
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    module, printed = loaded("consumer.py"), list[str]()
    monkeypatch.setattr(module, "Consumer", Entered)

    def three() -> bool:
        printed.extend(capsys.readouterr().out.splitlines())
        return len(printed) == 3

    await follow(broker, run, lambda: vars(module)["follow"](broker.url), three)
    assert [line.split()[1:4] for line in printed] == [
        ["rig", "0", "onset"],
        ["rig", "0", "end"],
        ["rig", "2", "onset"],
    ]


class Node:
    """Stands for rclpy.node.Node, as far as the bridge uses it."""

    def __init__(self, name: str) -> None:
        self.name, self.parameters, self.made = name, dict[str, Any](), dict[str, list[Any]]()
        self.warnings = list[str]()

    def declare_parameter(self, name: str, default: object) -> None:
        self.parameters.setdefault(name, default)

    def get_parameter(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(value=self.parameters[name])

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(warning=self.warnings.append)

    def create_publisher(self, kind: type, topic: str, qos: object) -> SimpleNamespace:
        assert re.fullmatch(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", topic, re.ASCII), "no name of a ROS topic"
        assert kind is SimpleNamespace
        assert qos
        assert topic not in self.made
        self.made[topic] = published = list[Any]()
        return SimpleNamespace(publish=lambda message: published.append(message.data))


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand-ins for the modules of ROS 2 that the bridge imports."""
    for name in ("rclpy", "rclpy.qos", "rclpy.signals", "std_msgs"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    monkeypatch.setitem(sys.modules, "rclpy.node", SimpleNamespace(Node=Node))
    messages = SimpleNamespace(String=SimpleNamespace, Bool=SimpleNamespace)
    monkeypatch.setitem(sys.modules, "std_msgs.msg", messages)


@pytest.mark.usefixtures("ros")
async def test_the_bridge_publishes_each_event_to_ros(
    broker: TestBroker, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = loaded("slip_bridge.py")
    monkeypatch.setattr(module, "Consumer", Entered)
    bridge = vars(module)["SlipBridge"]()
    bridge.parameters |= {"broker": broker.url, "position_file": str(tmp_path / "position")}
    events: list[str] = bridge.made["slip/events"]
    await follow(broker, run, bridge.follow, lambda: len(events) == 3)
    assert [Event.decode(each.encode()).state for each in events] == ["onset", "end", "onset"]
    assert bridge.made["slip/lab/rig/finger_0"] == [True, False]
    assert bridge.made["slip/lab/rig/finger_2"] == [True]
    assert not bridge.warnings
