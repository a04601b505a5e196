from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from operators import Commands, Grip, GripController, Scores, StepGrip, ms


def _pushed(grip: GripController, probability: Sequence[float], since: int = 0) -> Commands:
    times = (np.arange(len(probability)) + since) * 10 * ms
    return grip.push(Scores(times, np.array(probability), finger=2))


def _soon(**settings: float) -> Grip:
    values: dict[str, Any] = {"force": 1.0, "settle": 0, **settings}
    return Grip(**values)


def test_the_first_decision_commands_the_initial_force() -> None:
    for first in (0.0, 1.0, np.nan):
        commands = _pushed(Grip(force=0.7), [first, 0.0, 0.0])
        assert commands.force.tolist() == [0.7]
        assert commands.finger == 2


def test_decisions_while_the_hand_closes_are_ignored() -> None:
    assert len(_pushed(Grip(settle=200 * ms), [1.0] * 20)) == 1
    assert len(_pushed(Grip(settle=200 * ms), [1.0] * 24)) > 1


def test_one_decision_alone_is_no_slip() -> None:
    assert len(_pushed(_soon(), [0.0, 1.0, 0.0, 1.0, np.nan, 1.0, 0.0])) == 1


def test_the_growth_is_relative_to_the_force_that_slipped() -> None:
    grip = _soon(gain=2.0, latency=100 * ms)
    force = _pushed(grip, [0.0] + [1.0] * 40).force
    assert np.diff(force[:8]) == pytest.approx(0.02)  # of 1 N, in 10 ms
    assert np.diff(force)[-20:] == pytest.approx(0.02 * force[-31:-11])  # commanded 100 ms earlier


def test_commands_rise_no_faster_than_the_rate() -> None:
    commands = _pushed(_soon(gain=1000.0, rate=5.0), [0.0] + [1.0] * 20)
    assert (np.diff(commands.force) <= 5.0 * np.diff(commands.time) / 1e9 + 1e-12).all()
    assert commands.force[-1] > 1.5


def test_after_a_slip_the_force_falls_to_the_margin_above_its_mean_during_the_slip() -> None:
    grip = _soon(gain=5.0, latency=30 * ms, margin=0.02, release_rate=2.0)
    rising = _pushed(grip, [0.0] + [1.0] * 10).force
    after = _pushed(grip, [0.0] * 200, since=11).force
    assert after[0] == pytest.approx(rising[-1] * (1 - 2.0 * 0.01))
    assert (np.diff(after) < 0).all()
    earlier = [1.0] * 4 + rising[1:6].tolist()  # commanded 30 ms before each of nine decisions
    assert after[-1] == pytest.approx(1.02 * np.mean(earlier))


def test_a_later_slip_is_judged_by_its_own_forces() -> None:
    grip = _soon(gain=5.0, latency=30 * ms, margin=0.0, release_rate=100.0)
    first = _pushed(grip, [0.0] + [1.0] * 10 + [0.0] * 50).force[-1]
    second = _pushed(grip, [1.0] * 2 + [0.0] * 50, since=61).force[-1]
    assert second == pytest.approx(first)  # commanded when it slipped again


@pytest.mark.parametrize("period", [10 * ms, 60 * ms, 100 * ms, 500 * ms])
@pytest.mark.parametrize("kind", [Grip, StepGrip])
def test_at_any_rate_of_decisions_a_slip_raises_the_force_to_its_limit_but_a_gap_does_not(
    kind: type[GripController], period: int
) -> None:
    grip, time = kind(max_force=2.0), np.arange(100) * period
    assert grip.push(Scores(time, np.ones(100))).force[-1] == 2.0
    grip.max_force = 10.0
    resumed = time[-1] + max(4 * period, 51 * ms) + np.arange(2) * period
    assert grip.push(Scores(resumed, np.ones(2))).time.tolist() == [resumed[1]]


def test_the_papers_rule_adds_a_step_for_each_registered_slip_and_never_takes_one_back() -> None:
    grip = StepGrip(force=1.0, step=0.5, settle=0, rate=1e3)
    force = _pushed(grip, [0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, *[0.0] * 300]).force
    assert force.tolist() == [1.0, 1.5, 2.0]
