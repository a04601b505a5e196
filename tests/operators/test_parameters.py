"""Parameters that no operator or detector accepts."""

from math import inf, nan
from typing import Any

import numpy as np
import pytest

from operators import (
    Align,
    Debounce,
    DeviceClock,
    Grip,
    Health,
    Label,
    MaskLifted,
    ParameterError,
    Pool,
    Resample,
    StepGrip,
    Window,
    Zero,
    ms,
)  # fmt: skip
from operators.detectors import Psd

REFUSED: dict[Any, list[dict[str, Any]]] = {
    Zero: [
        *({"baseline": each} for each in (-40_000, 40_000, (), (0, 0, 0, 0, 0, 40_000))),
        *({"baseline": each} for each in (700.0, (700.9,) * 6, "x")),
        {"scans": 0},
    ],
    Align: [
        {"how": "next"},
        {"within": -1},
        {"keep": -1},
        {"how": "previous", "wait": -1},
        {"wait": 10 * ms},
    ],
    Label: [{"speed": -1}, {"speed": 0.3}, {"speed": nan}, {"rotation": -0.1}],
    Resample: [{"rate": 0}, {"rate": 1e-300}, {"rate": 2e6}, {"rate": nan}, {"gap": 0}],
    Pool: [
        *({"gain": each} for each in (0.0, inf, "2")),
        *({"groups": each} for each in (((),), ((1, 1),), ((-1,),), (0, 1), ((0.5,),))),
    ],
    MaskLifted: [
        {"contact_pose": each} for each in ((0, 0, 0.1), (0, 0, 0.1, 0, 0, nan), (0, 0, 0, 0, 0, "z"))
    ],
    Window: [{"length": 0}, {"hop": 0}, {"length": 2.5}],
    Psd: [{"length": 1}, {"cutoff": -1}, {"cutoff": 48}, {"cutoff": "9"}, {"length": 9.5}, {"threshold": 0}],
    Debounce: [
        *({"threshold": each} for each in (0, 1.1, nan)),
        *({"consecutive": 0}, {"release": 0}, {"consecutive": 2.5}, {"threshold": "x"}),
    ],
    Health: [*({"dead_after": 0}, {"stuck_after": 0}, {"clear_after": -1})],
    DeviceClock: [{"window": 59}, {"window": 0}, {"jump": -1}],
    Grip: [
        *(
            {"force": 11.0},
            {"force": "5N"},
            {"max_force": "9"},
            {"min_force": -1.0},
            {"threshold": 0.0},
            {"rate": 0.0},
            {"consecutive": 0},
        ),
        *({"gain": -1.0}, {"margin": -1.0}, {"release_rate": np.inf}, {"latency": -1}),
    ],
    StepGrip: [{"step": 0.0}],
}


@pytest.mark.parametrize(
    ("kind", "settings"), [(kind, settings) for kind, each in REFUSED.items() for settings in each]
)
def test_a_parameter_out_of_range_is_refused_by_its_name(kind: type[Any], settings: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=rf"^{kind.__name__}: .*{list(settings)[-1]}"):
        kind(**settings)


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        *((Align, each) for each in ({"within": 0.02}, {"within": 20}, {"keep": 10.0}, {"wait": 1e8})),
        *((Label, each) for each in ({"delay": 70}, {"delay": -0.07}, {"delay": "70ms"})),
    ],
)
def test_times_without_their_unit_are_refused(kind: type[Any], settings: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=r" .* must be in whole ns: for 20 ms write 20 \* ms"):
        kind(**settings)
