from pathlib import Path

import pytest

from connectors import Mqtt
from connectors.mqtt import rig_names
from connectors.mqtt.rig_names import host_rig, outbox_path, rig_topic


@pytest.mark.parametrize(
    ("host", "name"), [("ur10.lab.example", "ur10"), ("a b/c+", "a-b-c-"), ("", "rig"), ("x" * 99, "x" * 64)]
)
def test_by_default_a_rig_is_named_as_its_host(monkeypatch: pytest.MonkeyPatch, host: str, name: str) -> None:
    monkeypatch.setattr(rig_names, "gethostname", lambda: host)
    assert host_rig() == name == Mqtt("mqtt://localhost").rig
    assert rig_topic("Mqtt", "lab", name)


def test_each_rig_has_an_outbox_in_the_state_folder(state: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rigs = [("a", "b"), ("a-b", "c"), ("a", "b-c"), ("..", ".."), ("x" * 64, "y" * 64), ("ü", "~")]
    paths = [outbox_path(*rig) for rig in rigs]
    assert len(set(paths)) == len(rigs)
    assert all(path.parent == state / "slipflow" and len(path.name.encode()) < 250 for path in paths)
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    assert outbox_path("a", "b") == Path.home() / ".local" / "state" / "slipflow" / "a-b.outbox"
