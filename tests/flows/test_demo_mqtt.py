"""The demo against a real broker, seen by an independent subscriber."""

import json
import subprocess
import sys
from pathlib import Path

import jsonschema
import polars as pl
import pytest

from connectors.testing import TestBroker

SCHEMA = json.loads((Path(__file__).parents[2] / "connectors" / "slip-event.schema.json").read_text())


@pytest.mark.broker
def test_the_demo_goes_on_when_the_broker_is_killed_and_its_events_validate(
    tmp_path: Path, broker: TestBroker
) -> None:
    out, topic = tmp_path / "data", "slip/v1/lab/demo"
    listener = broker.listen(f"{topic}/+/event", f"{topic}/status")
    command = "from flows.command import main; main()"
    options = ["--for", "14s", "--out", str(out), "--mqtt", broker.url, "--json"]
    demo = subprocess.Popen(
        [sys.executable, "-c", command, "demo", *options], stdout=subprocess.PIPE, text=True
    )
    assert json.loads(listener.next(f"{topic}/status").payload)["state"] == "online"
    events = [json.loads(listener.next(f"{topic}/0/event").payload)]

    broker.stop()
    broker.start()
    listener = broker.listen(f"{topic}/+/event", f"{topic}/status")
    assert json.loads(listener.next(f"{topic}/status").payload)["state"] == "online"
    events += [json.loads(listener.next(f"{topic}/0/event").payload) for _ in range(2)]

    output, _ = demo.communicate(timeout=60)
    assert demo.returncode == 0
    for event in events:
        jsonschema.validate(event, SCHEMA)
    summary = json.loads(output.splitlines()[-1])
    assert summary["sinks"]["mqtt"]["failures"] > 0
    assert summary["sinks"]["mqtt"]["dropped"] == 0
    recorded = pl.read_parquet(f"{out}/sessions/*/slips.parquet")
    assert len(recorded) == summary["sinks"]["mqtt"]["rows"]
    assert {event["data"]["sample_time_ns"] for event in events} <= set(recorded["time"].to_list())
