import re
import subprocess
from time import time_ns

import pytest
from msgspec.structs import replace

from connectors.events import timestamp
from operators import s
from tests.command import SLIPFLOW
from tests.connectors.mqtt.broker_process import TestBroker
from tests.connectors.mqtt.made import EVENT

pytestmark = pytest.mark.broker


def started(*arguments: str) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    return subprocess.Popen([*SLIPFLOW, *arguments], stdout=pipe, stderr=pipe, text=True)


def publish(broker: TestBroker, seq: int, time: int, latency: float | None, *options: str) -> str:
    payload = replace(EVENT, seq=seq, time=time, probability=0.93, latency=latency).encode().decode()
    broker.publish("slip/v1/lab/ur10/0/event", payload, *options)
    return payload


def test_an_event_is_printed_as_received_in_json(broker: TestBroker) -> None:
    payload = publish(broker, 1, time_ns(), 8.5, "-r")
    watch = started("watch", broker.url, "--json")
    assert watch.stdout
    assert watch.stdout.readline() == payload + "\n"
    watch.terminate()
    watch.communicate()


def test_events_are_printed_on_a_line_each_and_errors_on_stderr(broker: TestBroker) -> None:
    watch = started("watch", broker.url, "--rig", "ur10")
    assert watch.stdout
    assert watch.stderr
    assert watch.stderr.readline() == f"connected to {broker.url}; waiting for slip events of +/ur10\n"
    for seq, age, latency, end in (
        (1, 0, 8.0, r"  sensor to event 8\.0 ms, sensor to here -?\d+\.\d ms"),
        (2, 90_000, 8.0, r"  sensor to event 8\.0 ms"),
        (3, 90_000, None, ""),
    ):
        time = time_ns() - age * s
        publish(broker, seq, time, latency)
        shown = f"{timestamp(time)[:23].replace('T', ' ')}  lab/ur10 finger 0  slip onset  p 0.93"
        assert re.fullmatch(re.escape(shown) + end + "\n", watch.stdout.readline())
    broker.publish("slip/v1/lab/ur10/1/event", "{}")
    assert watch.stderr.readline().startswith("ignoring malformed message: slip/v1/lab/ur10/1/event: ")
    watch.terminate()
    watch.communicate()
