"""Where the lift breaks: against delay, against the rate of samples, and where several are hard at once."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.experiment import SEED, STEPS, TRIALS, Found, Method, Progress, under
from flows.lab.experiments.lifting import LAGS, LIFT, Lifting
from flows.lab.experiments.slide_budget import Budget, budgets, climbing
from flows.lab.experiments.trial_setting import Conditions, Nature

DELAYS: Final = (0, 50, 100, 125, 150, 175, 200, 225, 250, 275, 300, 350, 400, 600)  # ms, added
RATES: Final = (200.0, 50.0, 25.0, 20.0, 10.0)  # Hz; a detector that learnt at 100 takes each for 10 ms
HELD: Final = (2, 4, 10, 20)  # samples at 100 Hz, of which one is a reading that is held for the others
# the delay that is added with each, ms
HARD: Final[Mapping[str, tuple[Conditions, int]]] = {
    "friction x0.5": (Conditions(nature=Nature(friction=0.5)), 0),
    "friction x0.5, +100 ms": (Conditions(nature=Nature(friction=0.5)), 100),
    "grip x0.5": (Conditions(weak=0.5), 0),
    "grip x0.5, +100 ms": (Conditions(weak=0.5), 100),
    "lift x2": (Conditions(pace=2.0), 0),
    "lift x2, +100 ms": (Conditions(pace=2.0), 100),
    "lift x4": (Conditions(pace=4.0), 0),
    "lift x4, +100 ms": (Conditions(pace=4.0), 100),
}
METHODS: Final = (Method("tcn_grasp"), Method("tcn", STEPS))
GOOD: Final = 90.0  # %, below which it is broken
ENOUGH: Final = 10  # trials of each object; of fewer, one that fails is below 90 %


@dataclass(frozen=True, slots=True)
class Ablation:
    """A lift under each condition, and what its trials leave a loop."""

    methods: tuple[str, ...]
    delays: Mapping[int, Found]  # by added delay, ms
    rates: Mapping[str, Found]  # by name
    hard: Mapping[str, Found]  # by name
    budgets: Mapping[str, Sequence[Budget]]  # by object, in the order of the trials

    @property
    def nominal(self) -> Found:
        """Without added delay."""
        return self.delays[0]

    @property
    def telling(self) -> bool:
        """Whether it can tell which object breaks first: there are several, and trials enough of each."""
        return len(self.nominal.objects) > 1 and self.nominal.trials >= ENOUGH

    def lifts(self, found: Found, method: str, thing: str) -> list[Lifting]:
        """The trials of an object."""
        return [each for each in found.outcomes[method, thing] if isinstance(each, Lifting)]

    def lost(self, found: Found, method: str, thing: str) -> float:
        """Share of trials in which it leaves the fingers, %."""
        return 100 * float(np.mean([each.lost for each in self.lifts(found, method, thing)]))

    def breaks(self, method: str, thing: str) -> float:
        """The added delay (ms) at which success falls below 90 %, between two that were tried."""
        return crossing(list(self.delays), [each.success(method, thing) for each in self.delays.values()])

    def loses(self, method: str, thing: str) -> float:
        """The added delay (ms) at which more than 10 % leave the fingers."""
        kept = [100 - self.lost(each, method, thing) for each in self.delays.values()]
        return crossing(list(self.delays), kept)

    def predicted(self, method: str, thing: str, *, lost: bool = False) -> float:
        """The added delay (ms) at which the budget of one trial in ten is spent; of `lost`, the reach's.

        The hand grips with what holds as long after the start of its way up as it does without added delay,
        and the delay later. What it has climbed by then is what the object has slid.
        """
        spare = sorted(
            _spare(each, trial, lost=lost)
            for each, trial in zip(self.budgets[thing], self.lifts(self.nominal, method, thing), strict=True)
        )
        return spare[len(spare) // 10]

    def first(self, method: str) -> str:
        """The object that breaks first."""
        return min(self.nominal.objects, key=lambda thing: self.breaks(method, thing))


def _spare(left: Budget, trial: Lifting, *, lost: bool) -> float:
    """The delay (ms) that could be added to a trial before it fails; infinite: nothing has to hold it."""
    if trial.lost if lost else not trial.success:
        return 0.0
    if not trial.firm > 0:  # held before it was lifted, or by a place that holds better
        return math.inf
    way = left.left if lost else min(LAGS - trial.give / 1000, left.left)  # m
    return 1000 * (climbing(LIFT, way) - trial.firm)


def crossing(at: Sequence[float], values: Sequence[float], level: float = GOOD) -> float:
    """Where values first fall below a level, between two places; infinite: nowhere.

    >>> crossing([0, 100, 200], [100, 95, 85])
    150.0
    """
    for place, value in enumerate(values):
        if value < level:
            if not place:
                return float(at[0])
            before = values[place - 1]
            return at[place - 1] + (at[place] - at[place - 1]) * (before - level) / (before - value)
    return math.inf


def rates(nominal: Conditions) -> dict[str, Conditions]:
    """The rates that are tried, by name; each differs from nominal in its rate only."""
    return {
        **{f"{rate:g} Hz": replace(nominal, rate=rate) for rate in RATES},
        **{f"{nominal.rate / every:g} Hz, held": replace(nominal, every=every) for every in HELD},
    }


def delayed(conditions: Conditions, added: float) -> Conditions:
    """The same with a delay (ms) added."""
    hand = conditions.hand
    return replace(conditions, hand=replace(hand, delay=hand.delay + added / 1000))


def ablation(
    methods: Sequence[Method] = METHODS,
    *,
    trials: int = TRIALS,
    seed: int = SEED,
    objects: Sequence[str] = tuple(OBJECTS),
    delays: Sequence[int] = DELAYS,
    jobs: int | None = None,
    progress: Progress = lambda _done, _all, _part: None,
) -> Ablation:
    """Lift under each condition, always with the same trials; see `experiment`.

    Args:
        methods: Each gets the same trials.
        trials: Of each object, under each condition.
        seed: Of the first trial; the next ones follow.
        objects: By name.
        delays: Added (ms); none is tried as well.
        jobs: Processes; None: one for each of the machine's cores.
        progress: Told how many trials are done, of how many, and under which condition.

    Raises:
        InputError: if there is no such detector or rule.
        ParameterError: on less than one trial, method or job, or no such object.
        SlipflowError: if a process ended early.
    """
    nominal = Conditions()
    added = sorted({0, *delays})
    late = {f"+{delay} ms": delayed(nominal, delay) for delay in added}
    slow = rates(nominal)
    hard = {name: delayed(conditions, late_by) for name, (conditions, late_by) in HARD.items()}
    found = under(
        "lift", methods, {**late, **slow, **hard},
        trials=trials, seed=seed, objects=objects, jobs=jobs, progress=progress,
    )  # fmt: skip
    left = budgets(
        objects, range(seed, seed + trials), nominal, jobs=jobs or os.cpu_count() or 1, progress=progress
    )
    return Ablation(
        tuple(method.name for method in methods),
        {delay: found[name] for delay, name in zip(added, late, strict=True)},
        {name: found[name] for name in slow},
        {name: found[name] for name in hard},
        left,
    )
