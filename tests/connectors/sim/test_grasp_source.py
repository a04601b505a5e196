import numpy as np
import pytest

from connectors.sim.grasp import GraspState
from connectors.sim.grasp_actions import Lift
from connectors.sim.grasp_source import SimulatedGrasp
from connectors.sim.objects import named
from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from operators import Commands, Run, Touch, concat, s

BOX = named("box")
START = 1_700_000_000 * s


def _force(time: int, force: float) -> Commands:
    return Commands(np.array([time]), np.array([force]))


def _taken(grasp: SimulatedGrasp, seconds: float, force: float | None = None) -> tuple[Touch, GraspState]:
    """Samples of a run in which a force is commanded after the first, and the state at its end."""

    async def main() -> Touch:
        clock, taken = LoopClock(START), list[Touch]()
        await grasp.hand.open(Run("run", "flow", clock, clock.now()))
        async for touch in grasp.batches(clock):
            if force is not None and not taken:
                await grasp.hand.write(_force(clock.now(), force))
            taken.append(touch)
            if len(taken) == round(seconds * 100):
                break
        return concat(Touch, taken)

    touch = run_virtually(main())
    assert grasp.grasp is not None
    return touch, grasp.grasp.sense(seconds)[1]


def test_touch_comes_every_ten_milliseconds_from_the_beginning_of_the_run() -> None:
    touch, _ = _taken(SimulatedGrasp(BOX), 0.5)
    assert touch.time.tolist() == [START + number * s // 100 for number in range(50)]


def test_what_is_commanded_is_gripped_and_lifted() -> None:
    _, state = _taken(SimulatedGrasp(BOX, lift=Lift(0.8)), 2.5, force=5.0)
    assert state.force == pytest.approx(5.0, rel=0.02)
    assert state.height == pytest.approx(0.05, abs=0.005)


def test_a_second_run_is_like_the_first() -> None:
    grasp = SimulatedGrasp(BOX, seed=4)
    (first, _), (second, _) = _taken(grasp, 1.0, force=3.0), _taken(grasp, 1.0, force=3.0)
    assert (first.counts == second.counts).all()
