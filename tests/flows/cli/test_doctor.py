import json
from pathlib import Path
from typing import Any

import pytest

from tests.command import slipflow
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


def test_without_a_flow_the_machine_is_checked(tmp_path: Path) -> None:
    found = findings(cwd=tmp_path)
    assert {each["part"] for each in found} == {"machine"}
    assert {"Python", "slipflow", "clock", "I2C"} < {each["subject"] for each in found}
    assert any(str(tmp_path / "recordings") in each["subject"] for each in found)
