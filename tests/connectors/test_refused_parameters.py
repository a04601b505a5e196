"""Parameters that no source, sink or device accepts."""

from math import nan
from typing import Any

import pytest

from connectors import Consumer, Gripper, Metrics, Mqtt, Page, TakkTile, UrMotion
from connectors.sim.scene import Move
from connectors.ur.path_follower import PathFollower
from connectors.ur.ur_state import Bounds
from operators.errors import ParameterError

REQUIRED: dict[Any, dict[str, Any]] = {
    Gripper: {"host": "10.0.0.3"},
    Mqtt: {"url": "mqtt://localhost"},
    Consumer: {"url": "mqtt://localhost"},
    UrMotion: {"host": "10.0.0.2"},
    Bounds: {"low": (0, 0, 0), "high": (1, 1, 1)},
    PathFollower: {"speed": 0.05, "acceleration": 0.5},
    Move: {"motion": "hold", "seconds": 0.5},
}
REFUSED: dict[Any, list[dict[str, Any]]] = {
    TakkTile: [
        *({"rows": each} for each in ((), (0, 0), (8,), 0)),
        *({"rows": (0, 1), "fingers": each} for each in ((0,), (2, 2), (-1, 0))),
        *({"rate": 0.0}, {"rate": 334.0}, {"bus": -1}, {"bus": ""}),
    ],
    UrMotion: [{"rate": each} for each in (0, 1, 501, 60, nan)],
    Bounds: [{"high": (1, 0, 1)}, {"force": 0}],
    PathFollower: [{"points": [(0.0, 0.0, 0.0)] * 2}],
    Move: [{"rest": -0.1}, {"motion": "translation", "rest": 0.5}],
    Gripper: [*({"port": 65536}, {"port": "502"}, {"unit": -1})],
    Mqtt: [
        *(
            {level: each}
            for level in ("site", "rig")
            for each in ("a/b", "+", "a+", "#", "a\0b", "a\nb", "x" * 65)
        ),
        *({"model": {"id": "tcn", "version": "1"}}, {"model": {"id": "a\nb"}}),
        *({"model": {"sha256": each}} for each in ("0f", "G" * 64)),
        *({"url": "localhost"}, {"site": ""}, {"threshold": 1.5}, {"threshold": nan}, {"consecutive": 0}),
    ],
    Consumer: [{"url": "localhost"}, {"site": "#"}, {"rig": "a/b"}, {"site": ""}, {"since": "then"}],
    Page: [{"port": 70_000}, {"port": -1}, {"threshold": 1.5}],
    Metrics: [{"port": 65536}],
}


@pytest.mark.parametrize(
    ("kind", "settings"), [(kind, settings) for kind, each in REFUSED.items() for settings in each]
)
def test_a_parameter_out_of_range_is_refused_by_its_name(kind: Any, settings: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=rf"^{kind.__name__}: .*{list(settings)[-1]}"):
        kind(**REQUIRED.get(kind, {}) | settings)
