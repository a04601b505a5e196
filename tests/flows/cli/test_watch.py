import re
import subprocess
from time import time_ns

import pytest
from msgspec.structs import replace

from connectors import Event
from connectors.events import timestamp
from operators import s
from tests.command import SLIPFLOW
from tests.connectors.mqtt.broker_process import TestBroker
from tests.connectors.mqtt.made import EVENT

pytestmark = pytest.mark.broker


def started(*arguments: str) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    return subprocess.Popen([*SLIPFLOW, *arguments], stdout=pipe, stderr=pipe, text=True)


def event(rig: str, time: int, latency: float | None = 8.5) -> Event:
    return replace(EVENT, rig=rig, time=time, probability=0.93, latency=latency)


def test_an_event_is_printed_as_received_in_json(broker: TestBroker) -> None:
    payload = event("ur10", time_ns()).encode().decode()
    broker.publish("slip/v1/lab/ur10/0/event", payload, "-r")
    watch = started("watch", broker.url, "--json")
    assert watch.stdout
    assert watch.stdout.readline() == payload + "\n"
    watch.terminate()
    watch.communicate()


@pytest.mark.parametrize(
    ("rig", "age", "latency", "end"),
    [
        ("ur10", 0, 8, r"  sensor to event 8\.0 ms, sensor to here -?\d+\.\d ms"),
        ("ur10", 90_000, 8, r"  sensor to event 8\.0 ms"),
        ("ur10", 90_000, None, ""),
    ],
)
def test_events_are_printed_on_a_line_each_and_errors_on_stderr(
    broker: TestBroker, rig: str, age: int, latency: float | None, end: str
) -> None:
    time = time_ns() - age * s
    broker.publish(f"slip/v1/lab/{rig}/0/event", event(rig, time, latency).encode().decode(), "-r")
    broker.publish(f"slip/v1/lab/{rig}/1/event", "{}", "-r")
    watch = started("watch", broker.url, "--rig", rig)
    assert watch.stdout
    assert watch.stderr
    line = watch.stdout.readline()
    shown = f"{timestamp(time)[:23].replace('T', ' ')}  lab/{rig} finger 0  slip onset  p 0.93"
    assert re.fullmatch(re.escape(shown) + end + "\n", line)
    assert watch.stderr.readline() == f"connected to {broker.url}; waiting for slip events of +/{rig}\n"
    assert watch.stderr.readline().startswith(f"ignoring malformed message: slip/v1/lab/{rig}/1/event: ")
    watch.terminate()
    watch.communicate()
