"""`slipflow demo` in processes of its own: its page, and brokers that refuse it or are killed."""

import asyncio
import json
import re
import signal
import subprocess
from pathlib import Path
from typing import Any

import jsonschema
import polars as pl
import pytest

from tests.asyncapi import EVENT_SCHEMA
from tests.command import SLIPFLOW, slipflow
from tests.connectors.mqtt.broker_process import TestBroker
from tests.connectors.web.reading import listening
from tests.waiting import PATIENCE


def summary(output: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(output.splitlines()[-1])
    return found


def slips(out: Path) -> list[int]:
    """Return the times of the recorded slips, ns."""
    return pl.read_parquet(f"{out}/sessions/*/slips.parquet")["time"].to_list()


def test_the_demo_serves_its_page_and_reports_what_it_detected(tmp_path: Path) -> None:
    command = [*SLIPFLOW, "demo", "--for", "60s", "--out", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr
    address = next(
        filter(None, (re.search(r"live page: (http://127\.0\.0\.1:\d+)", line) for line in process.stderr))
    )

    async def follow() -> None:
        async with listening(address[1]) as frames:
            about = (await anext(frames))["run"]
            assert (about["flow"], about["recording"], 0 < about["threshold"] < 1) == ("demo", None, True)
            rows = await anext(frame["rows"] async for frame in frames if "scores" in frame["rows"])
            assert [*rows["touch"]] == ["0"]
            process.send_signal(signal.SIGTERM)
            *_, last = [frame async for frame in frames]
            assert last["end"] == {"error": None}

    asyncio.run(follow())
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert re.search(r"\d+ true slips: \d+ detected, \d+ missed", output)


@pytest.mark.broker
def test_a_requested_broker_that_refuses_is_a_one_line_error(tmp_path: Path) -> None:
    with TestBroker(tmp_path, "allow_anonymous false") as broker:
        done = slipflow("demo", "--mqtt", broker.url, "--for", "8s", cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.splitlines()[-1].startswith(f"error: {broker.url}: ")


@pytest.mark.broker
def test_watch_receives_every_event_although_the_broker_is_killed(tmp_path: Path, broker: TestBroker) -> None:
    out, topic = tmp_path / "data", "slip/v1/lab/demo"
    listener = broker.listen(f"{topic}/+/event", f"{topic}/status")
    options = ["watch", broker.url, "--json", "--since", "start", "--position", str(tmp_path / "position")]
    watch = subprocess.Popen([*SLIPFLOW, *options], stdout=subprocess.PIPE, text=True)
    options = ["--for", "10s", "--set", f"out={out}", "--set", f"broker={broker.url}", "--json"]
    demo = subprocess.Popen([*SLIPFLOW, "run", "demo", *options], stdout=subprocess.PIPE, text=True)
    assert json.loads(listener.next(f"{topic}/status").payload)["state"] == "online"
    listener.next(f"{topic}/0/event")

    broker.stop()
    broker.start()
    listener = broker.listen(f"{topic}/+/event", f"{topic}/status")
    assert json.loads(listener.next(f"{topic}/status").payload)["state"] == "online"

    output, _ = demo.communicate(timeout=2 * PATIENCE)
    assert demo.returncode == 0
    mqtt = summary(output)["sinks"]["mqtt"]
    recorded = slips(out)
    assert (mqtt["rows"], mqtt["dropped"], mqtt["failures"]) == (len(recorded), 0, 0)

    assert watch.stdout
    events = [json.loads(watch.stdout.readline()) for _ in recorded]
    watch.send_signal(signal.SIGINT)
    rest, _ = watch.communicate(timeout=PATIENCE)
    assert not rest
    for event in events:
        jsonschema.validate(event, EVENT_SCHEMA)
    assert {event["data"]["seq"] for event in events} == set(range(1, len(recorded) + 1))
    assert sorted(event["data"]["sample_time_ns"] for event in events) == sorted(recorded)
