"""The lift as a declared flow on the simulated grasp."""

import pytest

from connectors.sim.grasp import GraspState, least_force
from connectors.sim.hand import Hand
from connectors.sim.objects import OBJECTS
from flows.graph import Flow
from flows.graph.testing import TestSink, run_virtually
from flows.lift import SIMULATED_SETTLE, lift
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from operators import Commands, Debounce, Grip, InputError, ParameterError, Run, Score, Zero, s
from storage import load_debounce, load_detector

DETECTOR = "tcn_grasp"


def _for(flow: Flow, seconds: int) -> Run:
    async def main() -> Run:
        clock = LoopClock(1_700_000_000 * s)
        return await LiveRunner(flow, "test", clock=clock, duration=seconds * s).execute()

    return run_virtually(main())


def _is_held(last: GraspState) -> bool:
    return not last.dropped and not last.on_table and last.hand - last.height < 0.02


def test_an_unknown_object_is_refused() -> None:
    with pytest.raises(ParameterError, match="lift: thing is 'anvil', must be one of box, ball"):
        lift(thing="anvil")


def test_hardware_needs_both_bus_and_gripper() -> None:
    with pytest.raises(InputError, match="needs both bus and gripper"):
        lift(gripper="10.0.0.3")
    assert [node.name for node in lift(gripper="10.0.0.3", bus=1).sinks()] == ["console", "gripper"]
    assert [node.name for node in lift().sinks()] == ["console", "hand"]


@pytest.mark.parametrize("ruled", [True, False])
def test_the_flow_holds_an_object_that_is_lost_without_it(*, ruled: bool) -> None:
    ball = OBJECTS["ball"]
    hand, commands, flow = Hand(ball, seed=3), TestSink(), Flow("lift")
    debounce, force = load_debounce(DETECTOR) or Debounce(), least_force(ball) / 2
    rule = Grip(force=force, threshold=debounce.threshold, settle=SIMULATED_SETTLE)
    rule = rule if ruled else Grip(force=force, gain=0.0)
    given = flow.source(hand.touch) | Zero() | Score(load_detector(DETECTOR)) | rule
    given.to(hand)
    given.to(commands)
    run = _for(flow, 6)
    assert not any(status.error for status in run.sinks.values())
    assert not any(status.error for status in run.sources.values())
    assert hand.grasp is not None
    _, last = hand.grasp.sense(6.0)
    assert _is_held(last) is ruled
    assert (len(commands.rows(Commands, 0)) > 1) is ruled
