"""A collection plan on the simulated rig, as a dataset: the same seed gives the same bytes.

Each recording of the plan becomes a session, through the flow that records live ones. The split is by
recording, never by window, about 70/10/20 of every surface, speed and kind of motion. All is written to
``OUT.partial``, which becomes OUT when it is whole.
"""

import asyncio
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, astuple, dataclass
from functools import partial
from operator import add
from pathlib import Path
from time import perf_counter
from typing import Any, Final, cast

import numpy as np

from connectors import SimulatedRig
from connectors.sim.paper_plan import PaperPlan, PaperStrokes, varied
from connectors.sim.scene import Scene
from flows.graph import Flow
from flows.learn.splits import SPLITS, TURNS
from flows.record import declare_recording
from flows.run.clocks import EventClock
from flows.run.processes import process_map
from flows.run.replay_runner import ReplayRunner
from operators import Label, Source
from operators.batch import SLIP, STATIC, Batch, Labelled, concat, s
from operators.errors import ParameterError
from operators.ports import Description, SomeBatch
from storage import Dataset, Session
from storage.description import describe_dataset
from storage.layout import session_folder
from storage.partial import partial_folder

PLANS: Final[Mapping[str, PaperPlan]] = {
    "paper": PaperPlan(),
    "wide": PaperPlan(repeats=6, rotations=4, vary=varied),
    "tiny": PaperPlan(speeds=(0.05, 0.1), repeats=1, rotations=1, rounds=1),
}

_APART: Final = {"tiny": 1_000_000}  # of seeds: a small plan repeats no recording of a large one
_EPOCH: Final = 1_609_459_200 * s  # ns, 2021-01-01
_SPACING: Final = 60 * s  # ns between the beginnings of two recordings, which are shorter
_WHOLE: Final = 3600 * s  # ns, longer than any recording: a table of a session is one part


@dataclass(frozen=True, slots=True)
class Planned:
    """One recording of a plan."""

    session: str  # identifier
    scene: Scene
    seed: int
    start: int  # ns since 1970-01-01 UTC
    split: str


@dataclass(frozen=True, slots=True)
class Tally:
    """How much there is of a split."""

    sessions: int = 0
    samples: int = 0
    static: int = 0  # samples
    slip: int = 0  # samples; the rest has no motion to tell

    def __add__(self, other: "Tally") -> "Tally":
        return Tally(*map(add, astuple(self), astuple(other)))

    @property
    def static_share(self) -> float:
        """Of the samples that have a label."""
        return self.static / max(self.static + self.slip, 1)

    def counts(self) -> dict[str, float]:
        """All of it by name."""
        return {**asdict(self), "static_share": self.static_share}


@dataclass(frozen=True, slots=True)
class Collected:
    """A simulated dataset."""

    out: Path
    plan: str
    seed: int
    splits: Mapping[str, Tally]
    seconds: float  # that it took

    @property
    def all(self) -> Tally:
        """How much there is in all."""
        return sum(self.splits.values(), Tally())

    def summary(self) -> dict[str, Any]:
        """What was collected, for a program."""
        return {
            "dataset": str(self.out),
            "plan": self.plan,
            "seed": self.seed,
            "seconds": self.seconds,
            **self.all.counts(),
            "splits": {split: tally.counts() for split, tally in self.splits.items()},
        }

    def report(self) -> str:
        """The same for a person."""
        rows = [
            f"{split:10} {each.sessions:4} sessions {each.samples:8,} samples  {each.static_share:.0%} static"
            for split, each in {**self.splits, "all": self.all}.items()
        ]
        pattern = self.out / "sessions" / "*" / "samples" / "*.parquet"
        return "\n".join(
            [
                *rows,
                f"simulated in {self.seconds:.1f} s; dataset in {self.out}; open it with",
                f"  python -c \"import polars; print(polars.read_parquet('{pattern}'))\"",
            ]
        )


def recordings(plan: str, seed: int) -> list[Planned]:
    """The recordings of a plan, in order.

    >>> first = recordings("tiny", seed=0)[0]
    >>> first.session, first.scene.curvature
    ('plane-050-01', 'plane')

    Raises:
        ParameterError: on a plan that there is not, or a negative seed.
    """
    if plan not in PLANS:
        raise ParameterError("simulate", "plan", plan, f"one of {', '.join(PLANS)}")
    if seed < 0:
        raise ParameterError("simulate", "seed", seed, "0 or above")
    begin = seed + _APART.get(plan, 0)
    scenes = list(PLANS[plan].scenes(begin))
    groups = [_group(scene) for scene in scenes]
    counted, planned = Counter[str](), list[Planned]()
    for number, (scene, group, split) in enumerate(zip(scenes, groups, _splits(groups, seed), strict=True)):
        counted[group] += 1
        session = f"{group}-{counted[group]:02d}"
        own = int(np.random.SeedSequence([begin, number]).generate_state(1)[0])
        start = _EPOCH + (seed * len(scenes) + number) % 10**6 * _SPACING
        planned.append(Planned(session, scene, own, start, split))
    return planned


def _group(scene: Scene) -> str:
    """What recordings that repeat each other share: surface and speed in mm/s, or rotation."""
    speed = cast("PaperStrokes", scene.plan).speed
    return f"{scene.curvature}-{'rotation' if speed is None else f'{1000 * speed:03.0f}'}"


def _splits(groups: Sequence[str], seed: int) -> list[str]:
    """The split of each recording: by turns through all of them, like beside like, else in random order."""
    chance = np.random.default_rng([seed, 4]).permutation(len(groups))
    keys = [(group.endswith("rotation"), group, int(chance[k]), k) for k, group in enumerate(groups)]
    split = {key[-1]: TURNS[place % len(TURNS)] for place, key in enumerate(sorted(keys))}
    return [split[k] for k in range(len(groups))]


def simulate(
    out: Path,
    plan: str = "paper",
    seed: int = 0,
    *,
    delay: int = 0,
    jobs: int | None = None,
    progress: Callable[[int, int], object] = lambda _done, _all: None,
) -> Collected:
    """Simulate a plan into a new dataset.

    Args:
        out: The dataset's folder, new or empty.
        plan: One of `PLANS`.
        seed: Of everything that is random.
        delay: How much later than the barometers the arm's velocity is taken to come, ns; see `Label`.
        jobs: Processes; None: one for each of the machine's cores.
        progress: Told how many recordings are done, of how many.

    Raises:
        ParameterError: on a parameter that cannot be.
        EndpointError: if the folder is not empty or cannot be written to.
        SlipflowError: if a recording cannot be made; nothing is left then.
    """
    began = perf_counter()
    planned = recordings(plan, seed)
    tallies = {split: Tally() for split in SPLITS}
    with (
        partial_folder(out.resolve()) as root,
        closing(process_map(partial(_record, root, delay), planned, jobs)) as each,
    ):
        describe_dataset(root)
        progress(0, len(planned))
        for done, (split, tally) in enumerate(each, 1):
            tallies[split] += tally
            progress(done, len(planned))
    return Collected(out, plan, seed, tallies, perf_counter() - began)


def _record(root: Path, delay: int, planned: Planned) -> tuple[str, Tally]:
    """Record one session of a dataset."""
    asyncio.run(_run(root, delay, planned))
    session = Session.open(session_folder(root, planned.session))
    label = np.concatenate([batch.label for batch in session.read(Labelled, 0)])  # (n,)
    static, slip = int((label == STATIC).sum()), int((label == SLIP).sum())
    return planned.split, Tally(1, len(label), static, slip)


async def _run(root: Path, delay: int, planned: Planned) -> None:
    """Play a scene to its end, then run the recording flow over it; described as a live run would."""
    rig = SimulatedRig(planned.scene, planned.seed, pace=None)
    clock = EventClock(planned.start)
    streams: tuple[Source[Any], ...] = (rig.touch, rig.motion, rig.episodes, rig.truth)
    played = _Played(planned.session, await asyncio.gather(*(_all(each, clock) for each in streams)))
    flow = Flow("simulate")
    dataset = Dataset(root, part_span=_WHOLE, host="simulated")
    declare_recording(flow, rig, Label(speed=0.003, rotation=0.2, delay=delay), dataset)  # m/s, rad/s; paper
    runner = ReplayRunner(flow, played, planned.session, rows=max(map(len, played.streams)))
    about = {**rig.touch.describe(), "split": planned.split}
    runner.run.describe |= {"touch": about, "motion": rig.motion.describe()}
    await runner.execute()


async def _all(source: Source[SomeBatch], clock: EventClock) -> SomeBatch:
    return concat(source.kind, [batch async for batch in source.batches(clock)])


@dataclass(frozen=True, slots=True)
class _Played:
    """A scene that was played to its end, as a recording of the rig."""

    name: str
    streams: Sequence[Batch]

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        return tuple(batch.finger for batch in self.streams if isinstance(batch, kind))

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        for batch in self.streams:
            if isinstance(batch, kind) and batch.finger == finger:
                for start in range(0, len(batch), rows):
                    yield batch[start : start + rows]

    def describe(self) -> Description:
        return {}
