import asyncio
from typing import Any

import numpy as np
import pytest

from connectors.sim.scene import Move, Scene
from connectors.sim.simulated_rig import SimulatedRig, true_slips
from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from operators.batch import MOTIONS, SURFACES, Episodes, Touch, Truth, concat, ms
from operators.ports import Source

ORIGIN = 1_700_000_000_000_000_000
PLAN = (Move("hold", 0.5, force=0.0), Move("hold", 0.5, force=2.0), Move("translation", 0.9, 0.3, 45.0, 0.1))


def annotations(rig: SimulatedRig, start: int = ORIGIN) -> tuple[Touch, Episodes, Truth]:
    """Return touch, episodes and truth of a run that begins at `start` (ns)."""

    async def every(source: Source[Any], clock: LoopClock) -> Any:
        return concat(source.kind, [batch async for batch in source.batches(clock)])

    async def main() -> tuple[Touch, Episodes, Truth]:
        clock, sources = LoopClock(start), (rig.touch, rig.episodes, rig.truth)
        touch, episodes, truth = await asyncio.gather(*(every(each, clock) for each in sources))
        return touch, episodes, truth

    return run_virtually(main())


def test_a_second_run_repeats_the_first_from_its_own_origin() -> None:
    rig = SimulatedRig(Scene(PLAN))
    first, second = annotations(rig), annotations(rig, ORIGIN + 500)
    np.testing.assert_array_equal(first[0].counts, second[0].counts)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.time + 500, other.time)


def test_each_move_is_an_episode() -> None:
    _, episodes, _ = annotations(SimulatedRig(Scene(PLAN)))
    assert [MOTIONS[code] for code in episodes.motion] == ["hold", "hold", "translation"]
    assert (episodes.time - ORIGIN).tolist() == [0, 500 * ms, 1000 * ms]
    assert (episodes.end - ORIGIN).tolist() == [500 * ms, 1000 * ms, 1900 * ms]
    assert SURFACES[episodes.surface[2]] == "plane"
    assert episodes.direction[2] == pytest.approx(np.pi / 4)
    assert (episodes.speed[2], episodes.angular_speed[2]) == (0.1, 0.0)
    assert episodes.force[:2].tolist() == [0.0, 2.0]
    assert np.isnan([episodes.force[2], *episodes.depth]).all()


def test_a_slip_of_half_a_millimetre_goes_on_through_short_sticks_and_ends_at_a_long_one() -> None:
    sliding = [0.0] * 5 + [0.05] * 3 + [0.0] * 10 + [0.05] * 2 + [0.0] * 20 + [0.05] + [0.0] * 20 + [0.04]
    truth = Truth.rows(np.arange(len(sliding)) * 10 * ms, sliding, 2.0, 0)
    assert true_slips(truth) == [(50 * ms, 190 * ms), (400 * ms, 400 * ms)]
