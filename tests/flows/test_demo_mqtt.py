"""The demo against a real broker, seen by an independent subscriber."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import jsonschema
import polars as pl
import pytest

from connectors.mqtt.testing import TestBroker

SCHEMA = json.loads((Path(__file__).parents[2] / "connectors" / "slip-event.schema.json").read_text())


@pytest.mark.broker
def test_the_demo_goes_on_when_the_broker_is_killed_and_a_watch_gets_every_event(
    tmp_path: Path, broker: TestBroker
) -> None:
    out, topic = tmp_path / "data", "slip/v1/lab/demo"
    listener = broker.listen(f"{topic}/+/event", f"{topic}/status")
    command = [sys.executable, "-c", "from flows.commands.main import main; main()"]
    watched = ["watch", broker.url, "--json", "--since", "start", "--remember", str(tmp_path / "position")]
    watch = subprocess.Popen([*command, *watched], stdout=subprocess.PIPE, text=True)
    options = ["--for", "14s", "--out", str(out), "--mqtt", broker.url, "--json"]
    demo = subprocess.Popen([*command, "demo", *options], stdout=subprocess.PIPE, text=True)
    assert json.loads(listener.next(f"{topic}/status").payload)["state"] == "online"
    listener.next(f"{topic}/0/event")

    broker.stop()
    broker.start()
    listener = broker.listen(f"{topic}/+/event", f"{topic}/status")
    assert json.loads(listener.next(f"{topic}/status").payload)["state"] == "online"

    output, _ = demo.communicate(timeout=60)
    assert demo.returncode == 0
    summary = json.loads(output.splitlines()[-1])
    assert (summary["sinks"]["mqtt"]["failures"], summary["sinks"]["mqtt"]["dropped"]) == (0, 0)
    recorded = pl.read_parquet(f"{out}/sessions/*/slips.parquet")["time"].to_list()
    assert len(recorded) == summary["sinks"]["mqtt"]["rows"]

    assert watch.stdout
    events = [json.loads(watch.stdout.readline()) for _ in recorded]
    watch.send_signal(signal.SIGINT)
    rest, _ = watch.communicate(timeout=10)
    assert not rest
    for event in events:
        jsonschema.validate(event, SCHEMA)
    assert {event["data"]["seq"] for event in events} == set(range(1, len(recorded) + 1))
    assert sorted(event["data"]["sample_time_ns"] for event in events) == sorted(recorded)
