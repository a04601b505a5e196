"""docs/reference/asyncapi.json is a valid AsyncAPI 3.0 document of what a rig sends on a real broker."""

import asyncio
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cloudevents.core.bindings.http import HTTPMessage, from_structured_event
from cloudevents.core.formats.json import JSONFormat
from jsonschema import Draft7Validator, Draft202012Validator

from connectors import Mqtt
from connectors.mqtt.gap_replay import GapRequest
from operators.batch import Clocks, Faults, Slips, ms, s
from operators.health import FaultKind
from operators.ports import Run, SinkStatus, SourceStatus
from tests.connectors.mqtt.broker_process import Received, TestBroker
from tests.pages import ROOT, block
from tests.reference_pages import FOLDER

META: Any = json.loads((Path(__file__).parent / "asyncapi-3.0.0.schema.json").read_text())
DOCUMENT: Any = json.loads((FOLDER / "asyncapi.json").read_text())
RIG = "slip/v1/lab/rig"


def problems(topic: str, payload: str) -> list[str]:
    """Violations of the message of this topic that fits best; fails for an unknown topic."""
    channel, *_ = [  # replay/request also has the form of replay/<name>
        each
        for each in DOCUMENT["channels"].values()
        if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", each["address"]), topic)
    ]
    found = list[list[str]]()
    for name in channel["messages"]:
        message = DOCUMENT["components"]["messages"][name]
        validator: Any = Draft202012Validator(message["payload"]["schema"])
        found.append([error.message for error in validator.iter_errors(json.loads(payload))])
    return min(found, key=len)


def published(broker: TestBroker, run: Run) -> list[Received]:
    """All messages of a run with a fault, a clock, slips and a request for missed events."""
    listener = broker.listen("slip/#")

    async def main() -> None:
        sink = Mqtt(broker.url, model={"id": "tcn", "sha256": "0f" * 32}, threshold=0.5, consecutive=2)
        run.sources["touch"] = SourceStatus(rows=1000, up=True, newest=run.clock.now() - 5 * ms)
        run.sinks["dataset"] = SinkStatus(rows=990, dropped=10, error="disk full")
        await sink.open(run)
        now, cell = np.array([run.clock.now()]), np.array([3], np.int8)
        await sink.write(Faults(now, cell, np.array([FaultKind.STUCK], np.int8), np.array([True]), finger=0))
        await sink.write(Clocks(now, np.array([3 * s]), np.array([5e-5]), np.array([0.004])))
        for state, probability in (1, 0.9), (0, float("nan")):
            await sink.write(Slips(now, np.array([state], np.int8), now, np.array([probability]), finger=0))
        epoch = await asyncio.to_thread(
            lambda: json.loads(listener.next(f"{RIG}/0/event").payload)["data"]["epoch"]
        )
        request = GapRequest(epoch, 1, 5, f"{RIG}/replay/me").encode().decode()
        await asyncio.to_thread(broker.publish, f"{RIG}/replay/request", request)
        await asyncio.to_thread(lambda: [listener.next(f"{RIG}/replay/me") for _ in range(2)])
        await sink.close()

    everything = broker.listen("slip/#")
    asyncio.run(main())
    return everything.rest()


def test_the_document_follows_the_official_meta_schema() -> None:
    validator: Any = Draft7Validator(META)
    assert not [(error.json_path, error.message) for error in validator.iter_errors(DOCUMENT)]
    broken = {**DOCUMENT, "operations": {"x": {"action": "shout", "channel": {"$ref": "#/channels/head"}}}}
    assert list(validator.iter_errors(broken))


def test_every_reference_of_the_document_leads_somewhere() -> None:
    for path in re.findall(r'"\$ref": "#/((?:channels|components)/[^"]+)"', json.dumps(DOCUMENT)):
        found = DOCUMENT
        for step in path.split("/"):
            found = found[step]


@pytest.mark.broker
@pytest.mark.usefixtures("quiet")
def test_all_messages_of_a_rig_satisfy_the_document(broker: TestBroker, run: Run) -> None:
    messages = published(broker, run)
    levels = {received.topic.removeprefix(f"{RIG}/") for received in messages}
    assert levels == {
        *("0/event", "0/state", "head", "status", "info", "health", "replay/request", "replay/me"),
    }
    assert not {received.topic: found for received in messages if (found := problems(*received[:2]))}


@pytest.mark.parametrize("name", ["event", "state", "head", "status", "request", "answer"])
def test_the_examples_of_the_page_satisfy_the_document(name: str) -> None:
    topic = {"event": "0/event", "state": "0/state", "request": "replay/request", "answer": "replay/me"}
    payload = block(ROOT / "docs/reference/mqtt.md", name)
    assert not problems(f"{RIG}/{topic.get(name, name)}", payload)
    assert problems(f"{RIG}/{topic.get(name, name)}", "{}")


@pytest.mark.broker
@pytest.mark.usefixtures("quiet")
def test_the_cloudevents_library_reads_every_event(broker: TestBroker, run: Run) -> None:
    events = [each for each in published(broker, run) if each.topic == f"{RIG}/0/event"]
    assert len(events) == 2
    for received in events:
        message = HTTPMessage({"content-type": received.content_type}, received.payload.encode())
        event = from_structured_event(message, JSONFormat())
        sent = json.loads(received.payload)
        assert (event.get_id(), event.get_type()) == (sent["id"], sent["type"])
        assert (event.get_source(), event.get_specversion()) == ("/lab/rig/0", "1.0")
        assert event.get_data() == sent["data"]
        assert event.get_time() is not None
