"""The robot experiments over all objects, detectors and rules, in parallel, the same trials for each."""

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

from connectors.sim.objects import OBJECTS, named
from flows.lab.experiments.lifting import Lifting, lift
from flows.lab.experiments.tapping import Tapping, tap
from flows.lab.experiments.trial import By, Trace
from flows.lab.experiments.trial_setting import Conditions
from flows.lift import controller
from flows.run.one_thread import one_thread
from flows.run.process_map import process_map
from operators import GripController, StepGrip
from operators.errors import InputError, ParameterError
from storage import load_detector

Kind: TypeAlias = Literal["tap", "lift"]

TRIALS: Final = 20  # of each object; paper
SEED: Final = 900_000  # far from those of recordings that are learnt from
CHUNK: Final = 5  # trials that a process takes at once
OURS, STEPS, NONE = "ours", "steps", "none"  # rules
RULES: Final = (OURS, STEPS, NONE)


@dataclass(frozen=True, slots=True)
class Method:
    """A detector and a rule for the grip force."""

    detector: str  # a name, or a file of weights
    rule: str = OURS

    @property
    def name(self) -> str:
        """Its name in tables."""
        return f"{self.detector}, {self.rule}"

    def grip(self) -> GripController:
        """Its controller.

        Raises:
            InputError: if there is no such rule.
        """
        ours = controller(self.detector, 0.5)
        if self.rule == OURS:
            return ours
        if self.rule == STEPS:
            return StepGrip(threshold=ours.threshold)
        if self.rule == NONE:
            return replace(ours, gain=0.0, margin=0.0)
        raise InputError(self.rule, f"is no rule: there are {', '.join(RULES)}")


DEFAULT: Final = "tcn_grasp"
# what stands beside the default, unless told otherwise
BESIDE: Final[Mapping[Kind, Sequence[Method]]] = {
    "tap": [Method(name) for name in ("tcn", "paper_tcn", "frequency_cnn", "psd")],
    "lift": [
        Method(DEFAULT, STEPS),
        Method(DEFAULT, NONE),
        Method("tcn", OURS),
        *(Method(name, STEPS) for name in ("tcn", "paper_tcn", "frequency_cnn", "psd")),
    ],
}


Outcome: TypeAlias = Lifting | Tapping
Progress: TypeAlias = Callable[[int, int, str], object]  # done, of how many, whose


@dataclass(frozen=True, slots=True)
class Found:
    """All trials of an experiment, by method and object, in the order of their seeds."""

    kind: Kind
    trials: int
    seed: int
    conditions: Conditions
    outcomes: Mapping[tuple[str, str], Sequence[Outcome]]
    methods: tuple[str, ...]
    objects: tuple[str, ...]
    first: Method  # of the methods

    def success(self, method: str, thing: str) -> float:
        """Share of trials that went well, %."""
        outcomes = self.outcomes[method, thing]
        return 100 * sum(each.success for each in outcomes) / len(outcomes)

    def mean(self, method: str) -> float:
        """Mean success over the objects, %."""
        return sum(self.success(method, thing) for thing in self.objects) / len(self.objects)

    def all(self, method: str) -> list[Outcome]:
        """Every trial of a method."""
        return [each for thing in self.objects for each in self.outcomes[method, thing]]


def experiment(
    kind: Kind,
    methods: Sequence[Method],
    *,
    trials: int = TRIALS,
    seed: int = SEED,
    objects: Sequence[str] = tuple(OBJECTS),
    conditions: Conditions | None = None,
    jobs: int | None = None,
    progress: Progress = lambda _done, _all, _part: None,
) -> Found:
    """Carry an experiment out.

    Args:
        kind: tap or lift.
        methods: Each gets the same trials.
        trials: Of each object.
        seed: Of the first trial; the next ones follow.
        objects: By name.
        conditions: Of all trials.
        jobs: Processes; None: one for each of the machine's cores.
        progress: Told how many trials are done, of how many, and whose.

    Raises:
        InputError: if there is no such detector or rule.
        ParameterError: on less than one trial, method or job, or no such object.
        SlipflowError: if a process ended early.
    """
    found = under(
        kind, methods, {"": conditions or Conditions()},
        trials=trials, seed=seed, objects=objects, jobs=jobs, progress=progress,
    )  # fmt: skip
    return found[""]


def under(
    kind: Kind,
    methods: Sequence[Method],
    tried: Mapping[str, Conditions],
    *,
    trials: int = TRIALS,
    seed: int = SEED,
    objects: Sequence[str] = tuple(OBJECTS),
    jobs: int | None = None,
    progress: Progress = lambda _done, _all, _part: None,
) -> dict[str, Found]:
    """Carry an experiment out under several conditions, always with the same trials.

    Args:
        kind: tap or lift.
        methods: Each gets the same trials.
        tried: The conditions, by name.
        trials: Of each object, under each condition.
        seed: Of the first trial; the next ones follow.
        objects: By name.
        jobs: Processes; None: one for each of the machine's cores.
        progress: Told how many trials are done, of how many, and under which condition.

    Returns:
        What was found, by the names of the conditions.

    Raises:
        InputError: if there is no such detector or rule.
        ParameterError: on less than one trial, method, condition or job, or no such object.
        SlipflowError: if a process ended early.
    """
    workers = 1 if jobs is None else jobs
    sizes = {"trials": trials, "methods": len(methods), "conditions": len(tried), "jobs": workers}
    for name, value in sizes.items():
        if value < 1:
            raise ParameterError("experiment", name, value, "at least 1")
    for thing in objects:
        if thing not in OBJECTS:
            raise ParameterError("experiment", "object", thing, f"one of {', '.join(OBJECTS)}")
    things = tuple(objects)
    work = _Work(kind, {m.name: (load_detector(m.detector), m.grip()) for m in methods}, tried)
    chunks = [
        _Chunk(name, method.name, thing, range(first, min(first + CHUNK, seed + trials)))
        for name in tried
        for method in methods
        for thing in things
        for first in range(seed, seed + trials, CHUNK)
    ]
    jobs = min(os.cpu_count() or 1 if jobs is None else jobs, len(chunks))
    outcomes = {name: dict[tuple[str, str], list[Outcome]]() for name in tried}
    done, of = 0, trials * len(things) * len(methods) * len(tried)
    progress(0, of, "")
    with closing(process_map(work, chunks, jobs)) as each:
        for chunk, found in zip(chunks, each, strict=True):
            outcomes[chunk.condition].setdefault((chunk.method, chunk.thing), []).extend(found)
            done += len(found)
            progress(done, of, chunk.condition or f"{chunk.method}: {chunk.thing}")
    names = tuple(method.name for method in methods)
    return {
        name: Found(kind, trials, seed, conditions, outcomes[name], names, things, methods[0])
        for name, conditions in tried.items()
    }


@dataclass(frozen=True, slots=True)
class _Chunk:
    condition: str
    method: str
    thing: str
    seeds: range


@dataclass(frozen=True, slots=True)
class _Work:
    """Does some trials; goes to processes."""

    kind: Kind
    methods: Mapping[str, By]
    conditions: Mapping[str, Conditions]

    def __call__(self, chunk: _Chunk) -> list[Outcome]:
        by, conditions = self.methods[chunk.method], self.conditions[chunk.condition]
        with one_thread():
            return [one(self.kind, chunk.thing, seed, by, conditions)[1] for seed in chunk.seeds]


def one(kind: Kind, thing: str, seed: int, by: By, conditions: Conditions) -> tuple[Trace, Outcome]:
    """One trial of an experiment."""
    do = tap if kind == "tap" else lift
    return do(named(thing), seed, by, conditions)
