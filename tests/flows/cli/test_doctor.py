import re
from pathlib import Path

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


def findings(*arguments: str | Path, cwd: Path) -> dict[str, list[tuple[str, str]]]:
    """Return state and subject of the findings by part."""
    done, found = slipflow("doctor", *arguments, cwd=cwd), dict[str, list[tuple[str, str]]]()
    *lines, verdict = done.stdout.splitlines()
    for line in lines:
        if match := re.match(r"  (good|note|bad) +(.+?): ", line):
            found[next(reversed(found))].append((match[1], match[2]))
        else:
            found[line] = []
    bad = sum(state == "bad" for each in found.values() for state, _ in each)
    assert (done.returncode, verdict.endswith("nothing is bad")) == (int(bad > 0), not bad)
    return found


@pytest.mark.broker
def test_the_sources_and_sinks_of_a_flow_are_checked(broker: TestBroker, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(FLOW)
    found = findings("mine.py", "--set", f"broker={broker.url}", cwd=tmp_path)
    states = {part: [state for state, _ in each] for part, each in found.items() if part != "machine"}
    assert states == {
        "touch": ["good"],
        "dataset": ["good", "good"],
        "mqtt": ["good"] * 4,
        "metrics": ["good"],
    }
    broker.stop()
    found = findings("mine.py", "--set", f"broker={broker.url}", cwd=tmp_path)
    assert found["mqtt"][2:] == [("bad", f"mqtt://127.0.0.1:{broker.port}")]


def test_without_a_flow_the_machine_is_checked(tmp_path: Path) -> None:
    found = findings(cwd=tmp_path)
    assert [*found] == ["machine"]
    subjects = {subject for _, subject in found["machine"]}
    assert {"Python", "slipflow", "clock", "I2C"} < subjects
    assert any(str(tmp_path / "recordings") in each for each in subjects)
