"""Simulated datasets of collection plans; the same seed gives identical bytes.

Each recording of a plan becomes a session, written by the flow that records live. Splits are by recording,
never by window, about 70/10/20 for every surface, speed and kind of motion. The dataset is written to
``OUT.partial``, which is renamed to OUT when complete.
"""

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from connectors import SimulatedRig
from connectors.sim.drawn_grasp import simulate_grasp
from connectors.sim.finger import simulate_scene
from connectors.sim.paper_plan import PaperPlan, calm, varied
from connectors.sim.scene import PaperStrokes, Scene
from connectors.sim.simulated_rig import SLIDING, episode
from flows.graph import Flow
from flows.graph.testing import TestRecording, TestSource
from flows.learn.labelled_recordings import PAPER_LABEL, TURNS, scene_seed, sliding_motion
from flows.record import declare_recording
from flows.run.executor import map_tasks
from flows.run.replay_runner import ReplayRunner
from flows.run.session_output import new_session, remove_partial
from operators import Align, Label, Zero, ms
from operators.batch import Batch, Episodes, Motion, Touch, Truth, concat, s
from operators.checks import check_choice
from operators.fingertip import TAKKTILE
from storage import Dataset
from storage.files import partial_output

PLANS: Final[Mapping[str, PaperPlan]] = {
    "paper": PaperPlan(),
    "wide": PaperPlan(repeats=6, rotations=4, vary=varied),
    "slow": PaperPlan(
        speeds=(0.004, 0.006, 0.01, 0.02), repeats=4, rotations=0, strokes=PaperStrokes(stroke=1.5, pause=1.0)
    ),
    "calm": PaperPlan(repeats=6, rotations=1, vary=calm),
    "tiny": PaperPlan(speeds=(0.05, 0.1), repeats=1, rotations=1, strokes=PaperStrokes(rounds=1)),
}

GRASPS: Final = "grasps"  # plan
_GRASPS: Final = 1000  # recordings of this plan
_SEED_OFFSET: Final = {"tiny": 1_000_000}  # no recording of a small plan occurs in a large one
_EPOCH: Final = 1_609_459_200 * s  # ns, 2021-01-01
_SPACING: Final = 600 * s  # ns between the starts of two recordings, which are shorter


@dataclass(frozen=True, slots=True)
class PlannedRecording:
    """One recording of a plan."""

    session: str  # identifier
    scene: Scene | None  # None: a grasp
    seed: int  # of the scene, or number of the grasp
    start: int  # ns since 1970-01-01 UTC
    split: str

    def __str__(self) -> str:
        return self.session


def planned_recordings(plan: str, seed: int) -> list[PlannedRecording]:
    """Return the recordings of a plan, in order.

    >>> first = planned_recordings("tiny", seed=0)[0]
    >>> str(first), first.scene.curvature
    ('plane-050-01', 'plane')

    Raises:
        ParameterError: on an unknown plan.
    """
    check_choice("simulate", "plan", plan, (*PLANS, GRASPS))
    if plan == GRASPS:
        return [
            PlannedRecording(f"grasp-{n:03d}", None, n, _start(seed, n, _GRASPS), TURNS[n % len(TURNS)])
            for n in range(_GRASPS)
        ]
    first = seed + _SEED_OFFSET.get(plan, 0)
    scenes = list(PLANS[plan].scenes(first))
    groups = [_group(scene) for scene in scenes]
    counts, planned = Counter[str](), list[PlannedRecording]()
    for number, (scene, group, split) in enumerate(zip(scenes, groups, _splits(groups, seed), strict=True)):
        counts[group] += 1
        session = f"{group}-{counts[group]:02d}"
        start = _start(seed, number, len(scenes))
        planned.append(PlannedRecording(session, scene, scene_seed(first, number), start, split))
    return planned


def _start(seed: int, number: int, count: int) -> int:
    """Return the start of a recording (ns since 1970 UTC), another one for each recording and seed."""
    return _EPOCH + (seed * count + number) % 10**6 * _SPACING


def _group(scene: Scene) -> str:
    """Return surface and speed in mm/s, or rotation; recordings of a group are repetitions."""
    speed = cast("PaperStrokes", scene.plan).speed
    return f"{scene.curvature}-{'rotation' if speed is None else f'{1000 * speed:03.0f}'}"


def _splits(groups: Sequence[str], seed: int) -> list[str]:
    """Return the split of each recording, assigned in turn with the recordings of a group in random order."""
    order = np.random.default_rng([seed, 4]).permutation(len(groups))
    keys = [(group.endswith("rotation"), group, int(order[k]), k) for k, group in enumerate(groups)]
    split = {key[-1]: TURNS[turn % len(TURNS)] for turn, key in enumerate(sorted(keys))}
    return [split[k] for k in range(len(groups))]


def simulate(
    out: Path,
    plan: str = "paper",
    seed: int = 0,
    *,
    executor: Executor | None = None,
    progress: Callable[[int, int], object] = lambda _done, _total: None,
) -> Path:
    """Simulate a plan into a new dataset; return its folder.

    Args:
        out: Folder of the dataset, new or empty.
        plan: One of `PLANS`.
        seed: Random seed.
        executor: Executor of `flows.run.executor.workers`; None: this process. An error ends local processes.
        progress: Called with the number of recordings done and their total.

    Raises:
        ParameterError: on an unknown plan.
        EndpointError: if the folder is not empty or cannot be written to.
        SlipflowError: if a recording cannot be simulated; the folder is deleted then.
    """
    planned = planned_recordings(plan, seed)
    with partial_output(out.resolve()) as root:
        work = partial(_record, root, plan, seed)
        for _ in map_tasks(work, planned, executor, progress=progress):
            pass
        remove_partial(root, (each.session for each in planned))
    return out


def _record(root: Path, plan: str, seed: int, planned: PlannedRecording) -> None:
    """Record one session of a dataset."""
    with new_session(root, planned.session) as scratch:
        asyncio.run(_run(scratch, plan, seed, planned))


async def _run(root: Path, plan: str, seed: int, planned: PlannedRecording) -> None:
    """Replay what was simulated through a flow that records it; describe it as a live run would."""
    flow, dataset = Flow("simulate"), Dataset(root)
    sources: dict[str, dict[str, Any]]
    if planned.scene is None:
        touch, truth = simulate_grasp(seed, planned.seed)
        streams = _shifted((touch, truth, sliding_motion(truth)), planned.start)
        _declare_grasp(flow, dataset)
        fingertip, sources = TAKKTILE, {"touch": {"sensor": "TakkTile 2x3, simulated"}}
    else:
        rig = SimulatedRig(planned.scene, planned.seed)
        episodes = [
            episode(move, start, planned.start, planned.scene)
            for start, move in planned.scene.moves(planned.seed)
        ]
        streams = [*_shifted(simulate_scene(rig.scene, rig.seed), planned.start), concat(Episodes, episodes)]
        declare_recording(flow, rig, replace(PAPER_LABEL), dataset)
        fingertip = rig.touch.fingertip or TAKKTILE
        sources = {"touch": dict(rig.touch.describe()), "motion": dict(rig.motion.describe())}
    finished = TestRecording(planned.session, streams, fingertip)
    runner = ReplayRunner(flow, finished, planned.session, rows=max(map(len, streams)))
    sources["touch"] |= {
        "fingertip": fingertip.describe(),
        "plan": plan,
        "plan_seed": seed,
        "split": planned.split,
    }
    runner.run.describe |= sources
    await runner.execute()


def _shifted(batches: Iterable[Batch], start: int) -> list[Batch]:
    """Return batches whose times begin at `start` (ns) instead of 0."""
    return [replace(each, time=each.time + start) for each in batches]


def _declare_grasp(flow: Flow, dataset: Dataset) -> None:
    """Declare the recording of a grasp, labelled by the true sliding: no arm moves the fingertip over it."""
    touch = flow.source(TestSource(Touch, fingers=(0,)))
    truth = flow.source(TestSource(Truth, fingers=(0,)))
    sliding = flow.source(TestSource(Motion, fingers=(0,)), "sliding")
    samples = (touch | Zero()) & sliding | Align(within=20 * ms) | Label(speed=SLIDING)
    touch.to(dataset)
    truth.to(dataset)
    samples.to(dataset)
