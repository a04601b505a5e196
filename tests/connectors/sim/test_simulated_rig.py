import asyncio
import json
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import pytest

from connectors.sim.scene import Move, Moves, Scene
from connectors.sim.simulated_rig import SimulatedRig
from operators.batch import Batch, Motion, Touch, concat
from operators.errors import ParameterError
from operators.ports import Json, Source

ORIGIN = 1_700_000_000_000_000_000
PLAN = Moves(
    (
        Move("hold", 0.5, force=0.0),
        Move("hold", 0.5, force=2.0),
        Move("translation", 0.9, 0.3, 45.0, 0.1),
    )
)


class Virtual:
    """A clock that jumps to whatever is waited for."""

    def __init__(self, now: int = ORIGIN) -> None:
        self.time = now

    def now(self) -> int:
        return self.time

    async def sleep_until(self, time: int) -> None:
        await asyncio.sleep(0)
        self.time = max(self.time, time)


async def gather(source: Source[Any], clock: Virtual, at_most: int = 100_000) -> list[Batch]:
    batches: list[Batch] = []
    async for batch in source.batches(clock):
        batches.append(batch)
        if sum(map(len, batches)) >= at_most:
            break
    return batches


def run(
    rig: SimulatedRig, clock: Virtual | None = None, at_most: int = 100_000
) -> tuple[list[Touch], list[Motion]]:
    async def both() -> tuple[list[Batch], list[Batch]]:
        shared = clock or Virtual()
        return await asyncio.gather(gather(rig.touch, shared, at_most), gather(rig.motion, shared, at_most))

    touch, motion = asyncio.run(both())
    return cast("list[Touch]", touch), cast("list[Motion]", motion)


def test_both_streams_run_at_their_rates_from_one_origin() -> None:
    touch, motion = run(SimulatedRig(Scene(PLAN)))
    assert {len(batch) for batch in [*touch, *motion]} == {1}
    t, m = concat(Touch, touch), concat(Motion, motion)
    assert t.time[0] == ORIGIN
    assert set(np.diff(t.time).tolist()) == {10_000_000}
    assert m.time[0] == ORIGIN + 70_000_000
    assert set(np.diff(m.time).tolist()) == {8_000_000}


def test_a_paced_sample_comes_when_it_is_due() -> None:
    async def check() -> None:
        rig, clock = SimulatedRig(Scene(PLAN)), Virtual()
        async for batch in rig.touch.batches(clock):
            assert clock.now() == batch.time[0]

    asyncio.run(check())


def test_as_fast_as_it_goes_gives_the_same_rows_in_large_batches() -> None:
    paced, fast = run(SimulatedRig(Scene(PLAN), 3)), run(SimulatedRig(Scene(PLAN), 3, pace=None))
    assert [len(fast[0]), len(fast[1])] == [1, 1]
    for kind, slow, quick in ((Touch, paced[0], fast[0]), (Motion, paced[1], fast[1])):
        one, other = concat(kind, cast("Any", slow)), concat(kind, cast("Any", quick))
        for name in ("time", *(("counts",) if kind is Touch else ("velocity", "pose"))):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_a_second_run_repeats_the_first_from_its_own_origin() -> None:
    rig = SimulatedRig(Scene(PLAN), pace=None)
    first = run(rig)
    second = run(rig, Virtual(ORIGIN + 500))
    np.testing.assert_array_equal(first[0][0].counts, second[0][0].counts)
    np.testing.assert_array_equal(first[0][0].time + 500, second[0][0].time)
    np.testing.assert_array_equal(first[1][0].time + 500, second[1][0].time)


def test_episodes_are_filled_in_while_the_rig_runs() -> None:
    rig = SimulatedRig(Scene(PLAN), pace=None)
    described = rig.touch.describe()
    run(rig)
    episodes = cast("list[dict[str, Any]]", described["episodes"])
    assert [episode["motion"] for episode in episodes] == ["hold", "hold", "translation"]
    assert episodes[-1] == {
        "start": ORIGIN + 1_000_000_000,
        "end": ORIGIN + 1_900_000_000,
        "motion": "translation",
        "axis": "oblique",
        "direction_deg": 45.0,
        "speed": 0.1,
        "curvature": "plane",
    }


def test_episodes_follow_each_other_without_gap_or_overlap() -> None:
    rig = SimulatedRig(pace=None)
    run(rig, at_most=30_000)
    episodes = cast("list[dict[str, Any]]", rig.describe()["episodes"])
    assert len(episodes) > 100
    assert [episode["end"] for episode in episodes[:-1]] == [episode["start"] for episode in episodes[1:]]


def test_descriptions_are_plain_data() -> None:
    rig = SimulatedRig(seed=4)
    for source in (rig.touch, rig.motion):
        about = dict(source.describe())
        listed = cast("Sequence[Json]", about.pop("episodes", ()))  # alive, and made when asked for
        described = json.loads(json.dumps({**about, "episodes": [*listed]}))
        assert described["seed"] == 4


def test_the_truth_is_stamped_as_the_run_is() -> None:
    rig = SimulatedRig(Scene(PLAN), pace=None)
    touch, _ = run(rig)
    np.testing.assert_array_equal(rig.truth().time, touch[0].time)
    assert len(rig.truth().slips) == 1


def test_the_default_scene_goes_on_and_remembers_a_bounded_stretch() -> None:
    rig = SimulatedRig(pace=None, remember=10.0)
    touch, _ = run(rig, at_most=10_000)
    assert sum(map(len, touch)) == 10_000
    truth = rig.truth()
    assert 1000 <= len(truth) <= 2000
    assert truth.time[-1] == touch[-1].time[-1]


def test_several_fingertips_feel_the_same_motion_with_noise_of_their_own() -> None:
    touch, _ = run(SimulatedRig(Scene(PLAN), pace=None, fingers=(0, 2)))
    assert [batch.finger for batch in touch] == [0, 2]
    assert touch[0].counts.tobytes() != touch[1].counts.tobytes()


def test_the_baseline_of_the_default_scene_is_the_unloaded_level() -> None:
    touch, _ = run(SimulatedRig(pace=None), at_most=1000)
    counts = touch[0].counts
    assert (np.median(counts[:100], axis=0) >= 420).all()
    assert np.ptp(counts[:100], axis=0).max() < 10
    assert (counts[200:].min(axis=0) < np.median(counts[:100], axis=0) - 30).all()


def test_bad_parameters_are_refused() -> None:
    with pytest.raises(ParameterError, match="pace"):
        SimulatedRig(pace=0.0)
    with pytest.raises(ParameterError, match="fingers"):
        SimulatedRig(fingers=())
