from dataclasses import replace

import pytest

from connectors.mqtt.replay_name import is_replay, name_in, replay_name
from operators.errors import ParameterError
from operators.ports import Run


@pytest.mark.parametrize("live", [True, False])
@pytest.mark.parametrize("rig", ["ur10", "ur10-replay", "replay", "-replay"])
def test_a_replay_is_never_called_as_a_live_rig_may_be(run: Run, rig: str, *, live: bool) -> None:
    name = name_in(replace(run, recording="stroke", live=live), "Mqtt", rig)
    assert name == replay_name(rig)
    assert is_replay(name)
    with pytest.raises(ParameterError, match=f"^Mqtt: rig is '{name}', must be a name that does not end in"):
        name_in(run, "Mqtt", name)


def test_a_live_rig_keeps_its_name(run: Run) -> None:
    assert [name_in(run, "Mqtt", rig) for rig in ("ur10", "replay", "a-replay-b")] == [
        "ur10",
        "replay",
        "a-replay-b",
    ]
