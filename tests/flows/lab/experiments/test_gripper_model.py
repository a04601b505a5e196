import math
from typing import Any, cast

import numpy as np
import pytest

from connectors.sim.grasp import Grasp
from connectors.sim.objects import named
from flows.lab.experiments.gripper_model import Actuator, GripperModel
from operators import Commands, ParameterError, s


def _commands(*forces: float, instant: float = 0.1) -> Commands:
    times = np.full(len(forces), round(instant * s))
    return Commands(times, np.array(forces))


def _force(model: GripperModel, *commands: Commands, at: float = 1.0) -> float:
    """Return the force (N) at an instant (s)."""
    grasp = Grasp(named("box"))
    actuator = Actuator(model, grasp)
    for each in commands:
        actuator.execute(each)
    return grasp.sense(at)[1].force


def test_a_command_takes_effect_one_settling_time_after_the_refresh_that_follows_its_delays() -> None:
    model = GripperModel(sensing=0.007, path=0.001, refresh=0.005, settle=0.010)
    assert model.effect(0.0) == pytest.approx(0.020)
    assert model.effect(0.002) == pytest.approx(0.020)  # 10 ms: on a refresh
    assert model.effect(0.003) == pytest.approx(0.025)
    assert GripperModel(delay=0.05).effect(0.0) == pytest.approx(model.effect(0.0) + 0.05)


def test_force_has_255_steps_and_never_exceeds_the_command() -> None:
    model = GripperModel(span=10.0)
    for force in np.linspace(0, 10, 97).tolist():
        step = model.quantize(force)
        assert force - 10 / 255 < step <= force + 1e-9
        assert step * 25.5 == pytest.approx(round(step * 25.5))
    assert model.quantize(99.0) == 10.0


def test_force_changes_at_the_rate_of_the_gripper() -> None:
    model = GripperModel(rate=4.0)
    halfway = model.effect(0.1) + 0.25
    assert _force(model, _commands(5.0), at=halfway) == pytest.approx(1.0, abs=0.05)
    assert _force(model, _commands(5.0), at=3.0) == pytest.approx(5.0, rel=0.02)


def test_force_decreases_on_command() -> None:
    less = _commands(5.0), _commands(2.0, instant=1.0)
    assert _force(GripperModel(), *less, at=3.0) == pytest.approx(2.0, rel=0.02)
    assert _force(GripperModel(), *less, _commands(0.0, instant=1.5), at=3.0) == 0


def test_a_command_without_a_force_changes_nothing() -> None:
    assert _force(GripperModel(), _commands(3.0, math.nan), at=2.0) == pytest.approx(3.0, rel=0.02)


@pytest.mark.parametrize("name", ["sensing", "path", "settle", "delay", "refresh", "rate", "span"])
def test_a_negative_value_is_refused(name: str) -> None:
    with pytest.raises(ParameterError, match=name):
        GripperModel(**cast("Any", {name: -1.0}))
