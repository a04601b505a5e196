import re
import subprocess
from dataclasses import replace

import pytest

from connectors import Event
from tests.command import SLIPFLOW, slipflow
from tests.connectors.mqtt.broker_process import TestBroker

pytestmark = pytest.mark.broker


@pytest.mark.parametrize(
    ("latency", "created", "deviation", "direction"),
    [(8, "8.0 ms, ", 45, "direction 270 deg  "), (None, "", 46, "")],
)
def test_events_are_printed_on_a_line_each_and_errors_on_stderr(
    broker: TestBroker, latency: float | None, created: str, deviation: int, direction: str
) -> None:
    onset = Event("lab", "ur10", "0", "ab", 7, onset=True, time=10**9, probability=0.93, latency=latency)
    event = replace(onset, direction_deg=270, direction_sd_deg=deviation)
    broker.publish("slip/v1/lab/ur10/0/event", event.encode().decode(), "-r")
    broker.publish("slip/v1/lab/ur10/1/event", "{}", "-r")
    watch = subprocess.Popen(
        [*SLIPFLOW, "watch", broker.url, "--rig", "ur10"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert watch.stdout
    assert watch.stderr
    line = watch.stdout.readline()
    text, _, late = line.partition("here after ")
    assert text == "1970-01-01 00:00:01.000  lab/ur10 finger 0  slip onset  p 0.93  " + direction + created
    assert re.fullmatch(r"\d{5}\.\d days\n", late)
    assert watch.stderr.readline().startswith("ignoring malformed message: slip/v1/lab/ur10/1/event: ")
    watch.terminate()
    watch.communicate()


@pytest.mark.parametrize("options", [["mqtt://127.0.0.1:1"], ["localhost"], ["--since", "yesterday"]])
def test_a_usage_error_is_one_line_and_exit_code_2(options: list[str]) -> None:
    done = slipflow("watch", *options)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stderr
