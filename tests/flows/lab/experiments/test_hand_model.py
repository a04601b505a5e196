import math
from typing import Any, cast

import numpy as np
import pytest

from connectors.sim.grasp import Grasp
from connectors.sim.objects import named
from flows.lab.experiments.hand_model import Grasping, Hand
from operators import Commands, ParameterError, s


def _asked(*forces: float, instant: float = 0.1) -> Commands:
    times = np.full(len(forces), round(instant * s))
    return Commands(times, np.array(forces), np.full((len(forces), 6), np.nan))


def _force(hand: Hand, *commands: Commands, at: float = 1.0) -> float:
    """What presses at an instant (s)."""
    grasp = Grasp(named("box"), force=0.0, closing=0.0)
    grasping = Grasping(hand, grasp)
    for each in commands:
        grasping.take(each)
    return grasp.sense(at)[1].force


def test_a_command_is_heard_at_the_next_refresh_after_all_delays_and_has_its_effect_when_it_has_settled() -> (
    None
):
    hand = Hand(sensing=0.007, path=0.001, refresh=0.005, settle=0.010)
    assert hand.heard(0.0) == pytest.approx(0.020)
    assert hand.heard(0.002) == pytest.approx(0.020)  # 10 ms: on a refresh
    assert hand.heard(0.003) == pytest.approx(0.025)
    assert Hand(delay=0.05).heard(0.0) == pytest.approx(hand.heard(0.0) + 0.05)


def test_it_grips_in_255_steps_and_never_harder_than_asked() -> None:
    hand = Hand(span=10.0)
    for asked in np.linspace(0, 10, 97).tolist():
        step = hand.step(asked)
        assert asked - 10 / 255 < step <= asked + 1e-9
        assert step * 25.5 == pytest.approx(round(step * 25.5))
    assert hand.step(99.0) == 10.0


def test_the_force_changes_at_the_hands_rate() -> None:
    hand = Hand(rate=4.0)
    halfway = hand.heard(0.1) + 0.25
    assert _force(hand, _asked(5.0), at=halfway) == pytest.approx(1.0, abs=0.05)
    assert _force(hand, _asked(5.0), at=3.0) == pytest.approx(5.0, rel=0.02)


def test_it_eases_when_told_unless_it_locks() -> None:
    less = _asked(5.0), _asked(2.0, instant=1.0)
    assert _force(Hand(), *less, at=3.0) == pytest.approx(2.0, rel=0.02)
    assert _force(Hand(locks=True), *less, at=3.0) == pytest.approx(5.0, rel=0.02)
    assert _force(Hand(locks=True), *less, _asked(0.0, instant=1.5), at=3.0) == 0


def test_a_command_without_a_force_changes_nothing() -> None:
    assert _force(Hand(), _asked(3.0, math.nan), at=2.0) == pytest.approx(3.0, rel=0.02)


@pytest.mark.parametrize("name", ["sensing", "path", "settle", "delay", "refresh", "rate", "span"])
def test_a_value_below_nothing_is_refused(name: str) -> None:
    with pytest.raises(ParameterError, match=name):
        Hand(**cast("Any", {name: -1.0}))
