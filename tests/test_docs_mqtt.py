"""docs/reference/mqtt.md is the contract that a rig keeps on a real broker; its files run."""

import asyncio
import json
import os
import re
import subprocess
import sys
from collections.abc import Awaitable, Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Self

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from connectors import Consumer, Event, Mqtt
from connectors.events import encode
from connectors.mqtt.gap_replay import GapAnswer, GapRequest
from operators.batch import Slips, ms
from operators.ports import Run
from tests.connectors.mqtt.broker_process import Received, TestBroker, TestListener
from tests.pages import ROOT, block, commands, table
from tests.waiting import until

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]

PAGE = ROOT / "docs" / "reference" / "mqtt.md"
RIG = "slip/v1/lab/rig"
START = 99_000 * ms  # within the run


def shown(name: str) -> Any:  # noqa: ANN401 - JSON
    return json.loads(block(PAGE, name))


def slips(*states: int, finger: int = 0, time: int = START) -> Slips:
    """Rows 10 ms apart."""
    times = time + 10 * ms * np.arange(len(states))
    return Slips(times, np.array(states, np.int8), times, np.full(len(states), 0.93), finger=finger)


def use(sink: Mqtt, run: Run, body: Callable[[], Awaitable[None]]) -> None:
    async def main() -> None:
        await sink.open(run)
        try:
            await body()
        finally:
            await sink.close()

    asyncio.run(main())


def heard(listener: TestListener, *topics: str) -> dict[str, Received]:
    """The first message on each of these topics."""
    found = dict[str, Received]()
    while not set(topics) <= set(found):
        received = listener.next()
        found.setdefault(received.topic, received)
    return found


def topic(row: dict[str, str]) -> str:
    """The topic of a row of the page, of this rig, finger 0 and this asker."""
    return f"{RIG}/{row['topic'].strip('`')}".replace("<finger>", "0").replace("<name>", "logger-1")


def test_a_rig_publishes_the_documents_of_the_page(broker: TestBroker, run: Run) -> None:
    rows = table(PAGE, "## Topics")
    topics = [topic(row) for row in rows if row["topic"] != "`replay/request`"]
    listener = broker.listen(f"{RIG}/#")
    found = dict[str, Received]()

    async def ask() -> None:
        await asyncio.to_thread(lambda: found.update(heard(listener, f"{RIG}/0/event", f"{RIG}/0/state")))
        asked = {**shown("request"), "epoch": json.loads(found[f"{RIG}/0/event"].payload)["data"]["epoch"]}
        asked["reply_to"] = f"{RIG}/replay/logger-1"
        await asyncio.to_thread(broker.publish, f"{RIG}/replay/request", json.dumps(asked))
        await asyncio.to_thread(lambda: found.update(heard(listener, f"{RIG}/replay/logger-1")))

    async def body() -> None:
        await sink.write(slips(1, 0, 1, 0, 1, 0))
        await ask()

    sink = Mqtt(broker.url, model={"id": "tcn"}, threshold=0.777, consecutive=2)
    use(sink, run, body)
    retained = {received.topic for received in broker.listen(f"{RIG}/#").rest()}
    assert retained == {topic(row) for row in rows if row["retained"] == "yes"}
    assert set(topics) - retained == {f"{RIG}/{name}" for name in ("0/event", "replay/logger-1")}
    published = {name: json.loads(found[f"{RIG}/0/{name}"].payload) for name in ("event", "state")}
    assert shown("event").keys() == published["event"].keys()
    assert shown("event")["data"].keys() == published["event"]["data"].keys()
    assert shown("state").keys() == published["state"].keys()


def test_the_retained_documents_have_the_fields_of_the_page(broker: TestBroker, run: Run) -> None:
    listener = broker.listen(f"{RIG}/#")
    found = dict[str, Received]()

    async def body() -> None:
        names = [f"{RIG}/{name}" for name in ("head", "status", "info", "health")]
        await asyncio.to_thread(lambda: found.update(heard(listener, *names)))

    use(Mqtt(broker.url), run, body)
    documents = {name.removeprefix(f"{RIG}/"): json.loads(each.payload) for name, each in found.items()}
    assert documents["head"].keys() == shown("head").keys() - {"before"}
    assert documents["status"].keys() == shown("status").keys()
    text = " ".join(PAGE.read_text().split())
    for name in ("info", "health"):
        [fields] = re.findall(rf"`{name}` has (.*?)[;.] ", text)
        named = set(re.findall(r"`(\w+)`", fields))
        assert named == documents[name].keys() - {"epoch", "session", "time_ns"}


@pytest.mark.parametrize("live", [True, False])
def test_a_replay_publishes_as_another_rig(broker: TestBroker, run: Run, *, live: bool) -> None:
    rows = table(PAGE, "## Topics")
    [command] = [words for words in commands(PAGE) if "--rig" in words]
    followed = f"slip/v1/lab/{command[command.index('--rig') + 1]}"
    replay, listener = replace(run, recording="stroke-9", live=live), broker.listen("slip/#")

    async def body() -> None:
        await sink.write(slips(1, 0))

    sink = Mqtt(broker.url)
    use(sink, replay, body)
    found = {received.topic: received for received in listener.rest()}
    unasked = [topic(row) for row in rows if not row["topic"].startswith("`replay/")]
    assert found.keys() == {each.replace(RIG, followed) for each in unasked}
    event, info = (json.loads(found[f"{followed}/{name}"].payload) for name in ("0/event", "info"))
    assert event["source"] == f"/{'/'.join(followed.split('/')[2:])}/0"
    assert event["data"]["session"] == info["session"] == run.session
    assert info["recording"] == "stroke-9"
    assert event["data"]["latency_ms"] is None


def test_the_documents_of_the_page_are_valid() -> None:
    schema = json.loads(files("connectors").joinpath("slip-event.schema.json").read_text(encoding="utf-8"))
    validator: Any = Draft202012Validator(schema)
    validator.validate(shown("event"))
    event = Event.decode(encode(shown("event")))
    assert json.loads(event.encode()) == shown("event")
    GapRequest.decode(encode(shown("request")), "slip/v1/lab/ur10")
    answer = shown("answer")
    missing = tuple((first, last) for first, last in answer["missing"])
    closing = GapAnswer(answer["epoch"], answer["from"], answer["to"], missing)
    assert json.loads(closing.encode()) == answer


# --- the files -------------------------------------------------------------------------------------------


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


def follow(
    broker: TestBroker, run: Run, work: Callable[[], Awaitable[None]], came: Callable[[], bool]
) -> None:
    """Let `work` follow a rig that raises events on two fingertips once it is connected; wait for them."""

    async def body() -> None:
        Entered.begun = asyncio.Event()
        working = asyncio.ensure_future(work())
        await Entered.begun.wait()
        await sink.write(slips(1, 0))
        await sink.write(slips(1, finger=2))
        await until(came)
        working.cancel()
        await asyncio.wait([working])

    sink = Mqtt(broker.url)
    use(sink, run, body)


def test_the_consumer_prints_each_event(
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

    follow(broker, run, lambda: vars(module)["follow"](broker.url), three)
    assert [line.split()[1:4] for line in printed] == [
        ["rig", "0", "onset"],
        ["rig", "0", "end"],
        ["rig", "2", "onset"],
    ]


def test_the_consumer_of_the_page_prints_one_line_if_there_is_no_broker(tmp_path: Path) -> None:
    (tmp_path / "consumer.py").write_text(block(PAGE, "consumer.py"))
    done = subprocess.run(
        [sys.executable, "consumer.py", "mqtt://127.0.0.1:1"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (1, "")
    [line] = done.stderr.splitlines()
    assert line.startswith("error: mqtt://127.0.0.1:1")


class Message:
    """Stands for std_msgs/String and Bool."""

    def __init__(self, *, data: object) -> None:
        self.data = data


class Publisher:
    """Stands for a publisher of rclpy."""

    def __init__(self) -> None:
        self.published: list[Any] = []

    def publish(self, message: Message) -> None:
        self.published.append(message.data)


class Node:
    """Stands for rclpy.node.Node, as far as the bridge uses it."""

    def __init__(self, name: str) -> None:
        self.name, self.parameters, self.made = name, dict[str, Any](), dict[str, Publisher]()
        self.warnings = list[str]()

    def destroy_node(self) -> None:
        self.made.clear()

    def declare_parameter(self, name: str, default: object) -> None:
        self.parameters.setdefault(name, default)

    def get_parameter(self, name: str) -> Any:  # noqa: ANN401 - what has a value
        return type("Parameter", (), {"value": self.parameters[name]})

    def get_logger(self) -> Any:  # noqa: ANN401 - what has a warning
        return type("Logger", (), {"warning": self.warnings.append})

    def create_publisher(self, kind: type, topic: str, qos: object) -> Publisher:
        assert isinstance(kind, type)
        assert re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*", topic), (
            "no name of a ROS topic"
        )
        assert qos
        assert topic not in self.made
        self.made[topic] = Publisher()
        return self.made[topic]


def anything(**settings: object) -> dict[str, object]:
    return settings


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Stand-ins for the modules of ROS 2 that the bridge imports; what was done to rclpy as a whole."""
    done = list[str]()

    def init(*, signal_handler_options: int) -> None:
        done.append(f"init {signal_handler_options}")

    kinds = type("String", (Message,), {}), type("Bool", (Message,), {})
    durability = type("DurabilityPolicy", (), {"TRANSIENT_LOCAL": 1})
    modules: dict[str, dict[str, object]] = {
        "rclpy": {"init": init, "try_shutdown": lambda: done.append("shutdown")},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"DurabilityPolicy": durability, "QoSProfile": anything},
        "rclpy.signals": {"SignalHandlerOptions": type("SignalHandlerOptions", (), {"NO": 0})},
        "std_msgs": {},
        "std_msgs.msg": {"String": kinds[0], "Bool": kinds[1]},
    }
    for name, members in modules.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    return done


def test_the_bridge_shuts_down_on_ctrl_c(ros: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    module = loaded("slip_bridge.py")

    async def interrupted(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(vars(module)["SlipBridge"], "follow", interrupted)
    vars(module)["main"]()
    assert ros == ["init 0", "shutdown"]


@pytest.mark.usefixtures("ros")
def test_the_bridge_publishes_each_event_to_ros(
    broker: TestBroker, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = loaded("slip_bridge.py")
    monkeypatch.setattr(module, "Consumer", Entered)
    bridge = vars(module)["SlipBridge"]()
    bridge.parameters |= {"broker": broker.url, "position_file": str(tmp_path / "position")}
    events: list[str] = bridge.made["slip/events"].published
    follow(broker, run, bridge.follow, lambda: len(events) == 3)
    assert [Event.decode(each.encode()).state for each in events] == ["onset", "end", "onset"]
    assert bridge.made["slip/lab/rig/finger_0"].published == [True, False]
    assert bridge.made["slip/lab/rig/finger_2"].published == [True]
    assert not bridge.warnings


@pytest.mark.usefixtures("ros")
def test_a_late_event_does_not_change_the_state() -> None:
    bridge = vars(loaded("slip_bridge.py"))["SlipBridge"]()
    for seq, time, onset in ((1, 10, True), (3, 30, False), (2, 20, True)):
        bridge.publish(
            Event("lab-1", "ur 10", "0", "e", seq, onset=onset, time=time, probability=0.9, latency=1)
        )
    assert len(bridge.made["slip/events"].published) == 3
    assert bridge.made["slip/lab_1/ur_10/finger_0"].published == [True, False]
