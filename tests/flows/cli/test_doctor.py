import json
from pathlib import Path
from typing import Any

import pytest

from tests.command import error, slipflow
from tests.connectors.mqtt.broker_process import TestBroker

FLOW = """
from connectors import Metrics, Mqtt, SimulatedRig
from flows.graph import Flow
from operators import Debounce, Score, Zero
from storage import Dataset, load_detector


def mine(broker: str = "mqtt://127.0.0.1:1", port: int = 0) -> Flow:
    flow = Flow("mine")
    touch = flow.source(SimulatedRig().touch)
    touch.to(Dataset("recordings"))
    slips = touch | Zero() | Score(load_detector("tcn")) | Debounce()
    slips.to(Mqtt(broker))
    slips.to(Metrics(port))
    return flow
"""


def findings(*arguments: str | Path, cwd: Path) -> list[dict[str, Any]]:
    done = slipflow("doctor", *arguments, "--json", cwd=cwd)
    result = json.loads(done.stdout)
    states = [each["state"] for each in result["findings"]]
    assert (result["good"], done.returncode) == ("bad" not in states, int("bad" in states))
    return list(result["findings"])


@pytest.mark.broker
def test_the_sources_and_sinks_of_a_flow_are_checked(broker: TestBroker, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(FLOW)
    found = findings("mine.py", "--set", f"broker={broker.url}", cwd=tmp_path)
    states = [(f["part"], f["state"]) for f in found if f["part"] != "machine"]
    assert states == [
        ("touch", "good"),
        ("dataset", "good"),
        ("dataset", "good"),
        *[("mqtt", "good")] * 4,
        ("metrics", "good"),
    ]
    assert not [f for f in found if f["part"] == "machine" and f["subject"].endswith(":9464")]
    broker.stop()
    port = broker.port
    bad = [
        f for f in findings("mine.py", "--set", f"broker={broker.url}", cwd=tmp_path) if f["part"] == "mqtt"
    ]
    assert [(f["subject"], f["state"]) for f in bad[2:]] == [(f"mqtt://127.0.0.1:{port}", "bad")]


def test_devices_can_be_given_without_a_flow(tmp_path: Path) -> None:
    done = slipflow(
        "doctor", "--bus", "99", "--robot", "127.0.0.1", "--mqtt", "mqtt://127.0.0.1:1", cwd=tmp_path
    )
    assert done.returncode == 1
    bad = [line.split(": ")[0].split()[1] for line in done.stdout.splitlines() if line.startswith("  bad")]
    assert [each for each in bad if each != "clock"] == [
        "/dev/i2c-99",
        "rtde://127.0.0.1:30004",
        "mqtt://127.0.0.1:1",
    ]
    assert done.stdout.splitlines()[-1] == f"{len(bad)} of {len(done.stdout.splitlines()) - 5} checks failed"


@pytest.mark.broker
def test_a_rig_can_be_named_whose_rights_are_checked(broker: TestBroker, tmp_path: Path) -> None:
    found = findings("--mqtt", broker.url, "--rig", "hall/ur10", cwd=tmp_path)
    assert any(f["text"].startswith("accepts slip/v1/hall/ur10/doctor ") for f in found)


def test_wrong_options_are_one_line(tmp_path: Path) -> None:
    assert error("doctor", "--set", "a=1") == "--set requires a flow"
    assert error("doctor", "--rows", "a", "--bus", "1") == "--rows a: must be row numbers such as 0,1"
    assert error("doctor", "--gripper", "a:b", cwd=tmp_path) == "--gripper a:b: write it as HOST or HOST:PORT"
