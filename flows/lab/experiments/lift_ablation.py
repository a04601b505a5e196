"""Limits of the lift: added delay, sample rate and hard conditions, and the delay that each object allows.

An object that is gripped too weakly stays on the table while the gripper rises: it slides as fast as the
gripper climbs, whatever the force. In the air it falls with the part of its weight that friction leaves::

    on the table   climbed(t) = distance                            the same for all objects
    in the air     t = sqrt(2 distance / (g (1 - force / least)))   for constant friction
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from connectors.sim.body import GRAVITY
from connectors.sim.grasp_actions import Lift
from connectors.sim.objects import named
from flows.lab.experiments.lift_trial import LIFT, ROOM, LiftOutcome, lift, lift_motion, weak_force
from flows.lab.experiments.study import (
    DEFAULT,
    STEPS,
    Method,
    Progress,
    Results,
    Trials,
    ignore_progress,
    run_study,
)
from flows.lab.experiments.trial import BASELINE, Conditions, NullDetector, Trial
from flows.run.processes import one_thread, process_map
from operators import Grip

DELAYS: Final = (0, 50, 100, 125, 150, 175, 200, 225, 250, 275, 300, 350, 400, 600)  # ms, added
RATES: Final = (200.0, 50.0, 25.0, 20.0, 10.0)  # Hz; a detector trained at 100 Hz takes each sample for 10 ms
REPEATS: Final = (2, 4, 10, 20)  # samples at 100 Hz per reading
# conditions and added delay, ms
HARD: Final[Mapping[str, tuple[Conditions, int]]] = {
    "friction x0.5": (Conditions(friction=0.5), 0),
    "friction x0.5, +100 ms": (Conditions(friction=0.5), 100),
    "grip x0.5": (Conditions(grip=0.5), 0),
    "grip x0.5, +100 ms": (Conditions(grip=0.5), 100),
    "lift x2": (Conditions(pace=2.0), 0),
    "lift x2, +100 ms": (Conditions(pace=2.0), 100),
    "lift x4": (Conditions(pace=4.0), 0),
    "lift x4, +100 ms": (Conditions(pace=4.0), 100),
}
METHODS: Final = (Method(DEFAULT), Method("tcn", STEPS))
GOOD: Final = 90.0  # %; a lower success counts as broken
ENOUGH: Final = 10  # trials of each object; with fewer, one failure is already below 90 %
FIRM: Final = 2.0  # times the least force, to lift the object into the air
AIR: Final = 4.0  # s; the force drops to the weak one then, 0.4 s after the arm has stopped
DROP_RATE: Final = 1000.0  # N/s
FALL: Final = 0.6  # s, simulated after the force drops
TICK: Final = 0.001  # s


@dataclass(frozen=True, slots=True)
class Budget:
    """Distances and times of a trial without control; times are NaN if the object slid less far."""

    reach: float  # m, slide until the object falls out of the gripper
    room: float  # m, slide up to which it counts as held
    share: float  # weak force over the least that holds
    table: float  # s to slide by `room` on the table, from the motion of the arm
    table_measured: float  # s
    air: float  # s to slide by `room` in the air, from the closed form
    air_measured: float  # s


@dataclass(frozen=True, slots=True)
class Ablation:
    """Results of the lift under each condition, and the budgets of its trials."""

    delays: Mapping[int, Results[LiftOutcome]]  # by added delay, ms
    rates: Mapping[str, Results[LiftOutcome]]  # by name
    hard: Mapping[str, Results[LiftOutcome]]  # by name
    budgets: Mapping[str, Sequence[Budget]]  # by object, in the order of the trials

    @property
    def nominal(self) -> Results[LiftOutcome]:
        """Results without added delay."""
        return self.delays[0]

    @property
    def ranks(self) -> bool:
        """True if there are enough objects and trials to name the object that breaks first."""
        trials = self.nominal.trials
        return len(trials.objects) > 1 and trials.count >= ENOUGH

    def breaking_delay(self, method: Method, name: str) -> float:
        """Return the added delay (ms) at which success falls below 90 %, interpolated."""
        return crossing(list(self.delays), [each.success(method, name) for each in self.delays.values()])

    def loss_delay(self, method: Method, name: str) -> float:
        """Return the added delay (ms) at which more than 10 % of the objects fall out of the gripper."""
        kept = [
            100 - 100 * float(np.mean([outcome.lost for outcome in results.of(method, name)]))
            for results in self.delays.values()
        ]
        return crossing(list(self.delays), kept)

    def predicted_delay(self, method: Method, name: str, *, lost: bool = False) -> float:
        """Return the added delay (ms) that uses up the room of one trial in ten; if `lost`, the reach.

        The added delay postpones the instant at which the grip becomes firm. Until then the object slides as
        far as the gripper climbs.
        """
        trials = zip(self.budgets[name], self.nominal.of(method, name), strict=True)
        spare = sorted(_spare(budget, outcome, lost=lost) for budget, outcome in trials)
        return spare[len(spare) // 10]

    def first_to_break(self, method: Method) -> str:
        """Return the object that breaks first."""
        return min(self.nominal.trials.objects, key=lambda name: self.breaking_delay(method, name))


def _spare(budget: Budget, outcome: LiftOutcome, *, lost: bool) -> float:
    """Return the delay (ms) that a trial tolerates before it fails; infinite if it needs no control."""
    if outcome.lost if lost else not outcome.success:
        return 0.0
    if not outcome.firm > 0:  # held before the lift, or where the texture grips better
        return math.inf
    distance = budget.reach if lost else min(ROOM - outcome.give / 1000, budget.reach)  # m
    return 1000 * (climb_time(LIFT, distance) - outcome.firm)


def crossing(at: Sequence[float], values: Sequence[float], level: float = GOOD) -> float:
    """Return where values first fall below a level, linearly interpolated; infinite if nowhere.

    >>> crossing([0, 100, 200], [100, 95, 85])
    150.0
    """
    for k, value in enumerate(values):
        if value < level:
            if not k:
                return float(at[0])
            before = values[k - 1]
            return at[k - 1] + (at[k] - at[k - 1]) * (before - level) / (before - value)
    return math.inf


def rate_conditions(nominal: Conditions) -> dict[str, Conditions]:
    """Return conditions by name; each differs from nominal in its sample rate or repeated readings."""
    return {
        **{f"{rate:g} Hz": replace(nominal, rate=rate) for rate in RATES},
        **{f"{nominal.rate / each:g} Hz, repeated": replace(nominal, repeat=each) for each in REPEATS},
    }


def delayed(conditions: Conditions, delay: float) -> Conditions:
    """Return the conditions with a delay (ms) added to the gripper."""
    gripper = conditions.gripper
    return replace(conditions, gripper=replace(gripper, delay=gripper.delay + delay / 1000))


def ablate(
    methods: Sequence[Method],
    trials: Trials,
    *,
    delays: Sequence[int] = DELAYS,
    jobs: int | None = None,
    progress: Progress = ignore_progress,
) -> Ablation:
    """Run the lift under each condition, always with the same trials.

    Args:
        methods: Detectors and rules.
        trials: Trials to run under each condition with each method.
        delays: Added delays (ms); 0 is always included.
        jobs: Number of processes; None: one per core.
        progress: Called with the number of trials done, their total and a label.

    Raises:
        InputError: if there is no such detector.
        ParameterError: on less than one method or job.
        SlipflowError: if a process ended early.
    """
    nominal = Conditions()
    late = {delay: f"+{delay} ms" for delay in sorted({0, *delays})}
    slow = rate_conditions(nominal)
    tried = {
        **{name: delayed(nominal, delay) for delay, name in late.items()},
        **slow,
        **{name: delayed(conditions, delay) for name, (conditions, delay) in HARD.items()},
    }
    results = run_study(lift, methods, tried, trials, jobs=jobs, progress=progress)
    return Ablation(
        {delay: results[name] for delay, name in late.items()},
        {name: results[name] for name in slow},
        {name: results[name] for name in HARD},
        slide_budgets(trials, nominal, jobs=jobs),
    )


def slide_budgets(
    trials: Trials, conditions: Conditions, *, jobs: int | None = None
) -> dict[str, list[Budget]]:
    """Return the budgets of the trials of each object, by its name."""
    work = partial(_budgets, trials.seeds, conditions)
    with closing(process_map(work, trials.objects, jobs)) as found:
        return dict(zip(trials.objects, found, strict=True))


def _budgets(seeds: range, conditions: Conditions, name: str) -> list[Budget]:
    with one_thread():
        return [slide_budget(name, seed, conditions) for seed in seeds]


def slide_budget(name: str, seed: int, conditions: Conditions) -> Budget:
    """Return the budget of one trial."""
    trial = Trial.draw(named(name), seed, conditions)
    force = weak_force(trial)
    reach = trial.held.reach - trial.position[1]
    room, share = min(ROOM, reach), force / trial.least_force
    trace, _ = lift(trial.held, seed, NullDetector(), Grip(), conditions)
    lifting = trace.between(LIFT.instant, math.inf)
    slide = trace.slide[lifting] - trace.slide[lifting][0]
    far = trace.t[lifting][(slide >= room) | trace.dropped[lifting]]
    return Budget(
        reach,
        room,
        share,
        table=climb_time(lift_motion(conditions), room),
        table_measured=float(far[0]) - LIFT.instant if len(far) else math.nan,
        air=fall_time(room, share),
        air_measured=_measured_fall(trial, force, room),
    )


def climb_time(motion: Lift, distance: float) -> float:
    """Return the time (s) that the gripper takes to climb `distance` (m); infinite if it never does.

    >>> round(climb_time(Lift(2.5), 0.02), 3)
    0.45
    """
    if distance >= motion.height:
        return math.inf
    t = np.linspace(0.0, motion.end - motion.instant, 10_001)
    return float(np.interp(distance, motion.climbed(motion.instant + t), t))


def fall_time(distance: float, share: float) -> float:
    """Return the time (s) that an object takes to slide `distance` (m) in the air; infinite if it is held.

    `share` is the grip force over the least that holds.

    >>> round(fall_time(0.024, 0.6), 3)
    0.111
    """
    return math.sqrt(2 * distance / (GRAVITY * (1 - share))) if share < 1 else math.inf


def _measured_fall(trial: Trial, force: float, distance: float) -> float:
    """Lift firmly, drop the force, and return the time (s) to slide `distance` (m); NaN if it does not."""
    grasp = trial.grasp(lift_motion(trial.conditions))
    grasp.press(FIRM * trial.least_force, BASELINE)
    _, held = grasp.sense(AIR)
    start = held.slide_y
    grasp.press(force, AIR, DROP_RATE)
    for tick in range(1, round(FALL / TICK)):
        _, held = grasp.sense(AIR + tick * TICK)
        if held.dropped or start - held.slide_y >= distance:
            return tick * TICK
    return math.nan
