import pytest

from connectors.sim.grasp import GraspState
from connectors.sim.hand import Hand
from connectors.sim.objects import OBJECTS
from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from operators import Commands, Run, Touch, concat, s

BOX = OBJECTS["box"]
START = 1_700_000_000 * s


def _taken(hand: Hand, seconds: float, force: float | None = None) -> tuple[Touch, GraspState]:
    """Samples of a run in which a force is commanded after the first, and the state at its end."""

    async def main() -> Touch:
        clock, taken = LoopClock(START), list[Touch]()
        await hand.open(Run("run", "flow", clock, clock.now()))
        async for touch in hand.touch.batches(clock):
            if force is not None and not taken:
                await hand.write(Commands.rows([clock.now()], force))
            taken.append(touch)
            if len(taken) == round(seconds * 100):
                break
        return concat(Touch, taken)

    touch = run_virtually(main())
    assert hand.grasp is not None
    return touch, hand.grasp.sense(seconds)[1]


def test_touch_comes_every_ten_milliseconds_from_the_beginning_of_the_run() -> None:
    touch, _ = _taken(Hand(BOX), 0.5)
    assert touch.time.tolist() == [START + number * s // 100 for number in range(50)]


def test_what_is_commanded_is_gripped_and_lifted() -> None:
    _, state = _taken(Hand(BOX), 6.2, force=5.0)
    assert state.force == pytest.approx(5.0, rel=0.02)
    assert state.height == pytest.approx(0.05, abs=0.005)


def test_a_second_run_is_like_the_first() -> None:
    hand = Hand(BOX, seed=4)
    (first, _), (second, _) = _taken(hand, 1.0, force=3.0), _taken(hand, 1.0, force=3.0)
    assert (first.counts == second.counts).all()
