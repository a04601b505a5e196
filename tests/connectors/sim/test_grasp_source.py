import asyncio

import numpy as np
import pytest

from connectors.sim.grasp_actions import Lift
from connectors.sim.grasp_source import SimulatedGrasp
from connectors.sim.objects import named
from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from operators import Commands, ParameterError, Run, Touch, concat, s

BOX = named("box")
START = 1_700_000_000 * s


def _force(time: int, force: float) -> Commands:
    return Commands(np.array([time]), np.array([force]), np.full((1, 6), np.nan))


def _taken(handling: SimulatedGrasp, force: float | None = None) -> Touch:
    """All samples of a run, in which a force is commanded after the first of them."""

    async def main() -> Touch:
        clock = LoopClock(START)
        await handling.hand.open(Run("run", "flow", clock, clock.now()))
        taken: list[Touch] = []
        async for touch in handling.touch.batches(clock):
            if force is not None and not taken:
                await handling.hand.write(_force(clock.now(), force))
            taken.append(touch)
        return concat(Touch, taken)

    return run_virtually(main())


def test_touch_comes_every_ten_milliseconds_from_the_beginning_of_the_run() -> None:
    touch = _taken(SimulatedGrasp(BOX, seconds=0.5))
    assert touch.time.tolist() == [START + number * s // 100 for number in range(50)]


def test_an_open_hand_feels_nothing_and_leaves_the_object_on_the_table() -> None:
    handling = SimulatedGrasp(BOX, lift=Lift(0.2), seconds=2.0)
    touch = _taken(handling)
    assert handling.states[-1].hand == pytest.approx(0.05)
    assert handling.states[-1].on_table
    assert np.ptp(touch.counts, axis=0).max() < 8  # noise


def test_what_is_commanded_is_gripped_and_lifted() -> None:
    handling = SimulatedGrasp(BOX, lift=Lift(0.8), seconds=2.5)
    _taken(handling, force=5.0)
    assert handling.states[-1].force == pytest.approx(5.0, rel=0.02)
    assert handling.states[-1].height == pytest.approx(0.05, abs=0.005)


def test_a_second_run_is_like_the_first() -> None:
    handling = SimulatedGrasp(BOX, seed=4, seconds=1.0)
    first, second = _taken(handling, force=3.0), _taken(handling, force=3.0)
    assert (first.counts == second.counts).all()
    assert len(handling.states) == 100


def test_a_command_without_force_or_before_the_run_changes_nothing() -> None:
    handling = SimulatedGrasp(BOX, seconds=0.5)
    handling.command(_force(START, 5.0))
    _taken(handling, force=float("nan"))
    assert handling.states[-1].force == 0


def test_its_time_must_be_above_nothing() -> None:
    with pytest.raises(ParameterError, match="seconds"):
        SimulatedGrasp(BOX, seconds=0.0)


def test_the_physics_is_compiled_before_the_run() -> None:
    asyncio.run(SimulatedGrasp(BOX).touch.prepare())
