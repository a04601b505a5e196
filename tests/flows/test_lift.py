"""The lift as a declared flow on the simulated grasp."""

import numpy as np
import pytest

from connectors.sim.grasp import Grasp, GraspState, least_force
from connectors.sim.hand import Hand
from connectors.sim.objects import OBJECTS
from connectors.sim.simulated_rig import SLIDING
from flows.graph import Flow
from flows.graph.testing import TestSink
from flows.lift import SIMULATED_SETTLE, lift
from operators import Commands, Grip, InputError, Score, Touch, Zero, s
from operators.batch import Counts, Reals
from tests.flows.run.live import execute


class Perfect:
    """A detector that knows how fast the pad of a grasp slides."""

    name, length = "perfect", 1

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._speed, sense = 0.0, Grasp.sense

        def seen(grasp: Grasp, instant: float) -> tuple[Touch, GraspState]:
            touch, state = sense(grasp, instant)
            self._speed = state.speed
            return touch, state

        monkeypatch.setattr(Grasp, "sense", seen)

    def score(self, windows: Counts | Reals) -> Reals:
        return np.full(len(windows), float(self._speed > SLIDING))


def _is_held(last: GraspState) -> bool:
    return not last.dropped and not last.on_table and last.hand - last.height < 0.02


def test_hardware_needs_both_bus_and_gripper() -> None:
    with pytest.raises(InputError, match="needs both bus and gripper"):
        lift(gripper="10.0.0.3")
    assert [node.name for node in lift(gripper="10.0.0.3", bus=1).sinks()] == ["console", "gripper"]
    assert [node.name for node in lift().sinks()] == ["console", "hand"]


@pytest.mark.parametrize("ruled", [True, False])
def test_the_rule_holds_what_is_lost_without_it(monkeypatch: pytest.MonkeyPatch, *, ruled: bool) -> None:
    ball = OBJECTS["ball"]
    hand, commands, flow = Hand(ball, seed=3), TestSink(), Flow("lift")
    rule = Grip(force=least_force(ball) / 2, gain=20.0 if ruled else 0.0, settle=SIMULATED_SETTLE)
    given = flow.source(hand.touch) | Zero() | Score(Perfect(monkeypatch)) | rule
    given.to(hand)
    given.to(commands)
    run = execute(flow, duration=7 * s, start=0)
    assert not any(status.error for status in run.sinks.values())
    assert not any(status.error for status in run.sources.values())
    assert hand.grasp is not None
    _, last = hand.grasp.sense(7.5)
    assert _is_held(last) is ruled
    assert (len(commands.rows(Commands, 0)) > 1) is ruled
