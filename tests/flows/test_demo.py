from pathlib import Path

from connectors import Mqtt
from flows.demo import demo
from flows.graph.validation import problems


def test_two_demos_at_once_publish_as_two_rigs_from_two_outboxes(tmp_path: Path) -> None:
    outbox = tmp_path / "left.outbox"
    flow = demo(str(tmp_path), "mqtt://localhost", rig="left", outbox=outbox)
    [mqtt] = [node.part for node in flow.nodes if isinstance(node.part, Mqtt)]
    assert (mqtt.rig, mqtt.outbox) == ("left", outbox)
    assert mqtt.destination == "mqtt://localhost:1883/slip/v1/lab/left"
    assert problems(flow) == []
