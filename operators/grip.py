"""Grip force control from slip probabilities."""

import math
from abc import abstractmethod
from collections import deque
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from operators.batch import Commands, Scores, ms, s
from operators.checks import check_above, check_at_least, check_between, check_whole
from operators.operator import Operator

_MOST: Final = 1e6  # of forces (N), rates (1/s) and the margin; no gripper exceeds it
_SHORTEST_GAP: Final = 50 * ms  # ns between two decisions
_GAP: Final = 3  # usual intervals; a gap is longer
_USUAL: Final = 5  # intervals whose median is the usual one


@dataclass
class GripController(Operator[Scores, Commands]):
    """Convert slip probabilities to grip force commands (base class of the control rules).

    The first decision commands `force`, which closes the hand. Decisions within `settle` after it are
    ignored, as the contact itself causes them. A slip is registered after `consecutive` decisions for slip
    in a row; NaN interrupts the run. A command is issued if it differs from the last one.

    A gap between decisions counts as no time, so that the force does not rise by it. It is longer than 50 ms
    and than three times the median of the five intervals before it.

    Args:
        force: Initial force, N.
        min_force: Lower limit, N.
        max_force: Upper limit, N.
        rate: Fastest increase, N/s; that of the gripper, so that its force follows the commands.
        threshold: Smallest probability that is a decision for slip.
        consecutive: Decisions that register a slip.
        settle: Time after the first command in which decisions are ignored, ns.

    Raises:
        ParameterError: if a parameter is invalid.
    """

    force: float = 0.5
    min_force: float = 0.0
    max_force: float = 10.0
    rate: float = 10.0
    threshold: float = 0.5
    consecutive: int = 2
    settle: int = 300 * ms
    _commanded: float = field(default=math.nan, init=False, repr=False)  # N, latest command
    _aim: float = field(default=0.0, init=False, repr=False)  # N, desired force
    _begun: int = field(default=0, init=False, repr=False)  # ns, first decision
    _before: int = field(default=0, init=False, repr=False)  # ns, latest decision
    _intervals: deque[int] = field(  # ns, the latest between decisions
        default_factory=lambda: deque([0] * _USUAL, _USUAL), init=False, repr=False, compare=False
    )
    _run: int = field(default=0, init=False, repr=False)  # slip decisions in a row

    def __post_init__(self) -> None:
        name = type(self).__name__
        check_between(name, "max_force", self.max_force, 0, _MOST, unit="N")
        check_between(name, "min_force", self.min_force, 0, self.max_force, unit="N")
        check_between(name, "force", self.force, self.min_force, self.max_force, unit="N")
        check_above(name, "threshold", self.threshold, 0)
        check_between(name, "threshold", self.threshold, 0, 1)
        check_above(name, "rate", self.rate, 0, "N/s")
        check_whole(name, "consecutive", self.consecutive, 1, "decision")
        check_at_least(name, "settle", self.settle, 0, "ns")

    def process(self, batch: Scores) -> Commands:
        """Return the commands that follow from the decisions."""
        rows: list[int] = []
        forces: list[float] = []
        values = zip(batch.time.tolist(), batch.probability.tolist(), strict=True)
        for row, (time, probability) in enumerate(values):
            force = self._decide(time, probability)
            if not math.isnan(force):
                rows.append(row)
                forces.append(force)
        if not rows:
            return Commands.empty()
        return Commands(batch.time[rows], np.array(forces), finger=batch.finger)

    @abstractmethod
    def aim(self, time: int, elapsed: float, probability: float, *, registered: bool) -> float:
        """Return the desired force (N), before limits.

        Args:
            time: Time of the decision, ns.
            elapsed: Time since the last decision, s; 0 if that is a gap.
            probability: Probability of slip; NaN: unknown.
            registered: Whether a slip is registered.
        """

    def _decide(self, time: int, probability: float) -> float:
        """Return the force to command, N; NaN: no command."""
        if math.isnan(self._commanded):
            self._begun = self._before = time
            self._aim = self._commanded = self.force
            return self.force
        since, self._before = time - self._before, time
        usual = sorted(self._intervals)[_USUAL // 2]
        self._intervals.append(since)
        elapsed = since / s if since <= max(_SHORTEST_GAP, _GAP * usual) else 0.0
        settled = time - self._begun >= self.settle
        self._run = self._run + 1 if settled and probability >= self.threshold else 0
        registered = self._run >= self.consecutive
        if not settled:
            return math.nan
        wanted = self.aim(time, elapsed, probability, registered=registered)
        self._aim = min(max(wanted, self.min_force), self.max_force, self._aim + self.rate * elapsed)
        if self._aim == self._commanded:
            return math.nan
        self._commanded = self._aim
        return self._aim


@dataclass
class StepGrip(GripController):
    """Raise the grip force by a step per registered slip, as in the paper.

    A lasting slip is registered again after `consecutive` more decisions. The force never decreases.

    Args:
        step: Force step, N; the paper does not state its value.

    Raises:
        ParameterError: if a parameter is invalid.

    References:
        "Under Pressure" (2021), section V-B.

    >>> scores = Scores(np.arange(6) * 10 * ms, np.array([0.1, 0.9, 0.9, 0.9, 0.9, 0.1]))
    >>> StepGrip(force=1.0, step=0.1, settle=0).push(scores).force
    array([1. , 1.1, 1.2])
    """

    step: float = 0.15
    _wanted: float = field(default=0.0, init=False, repr=False)  # N

    def __post_init__(self) -> None:
        super().__post_init__()
        check_above("StepGrip", "step", self.step, 0, "N")
        self._wanted = self.force

    def aim(self, time: int, elapsed: float, probability: float, *, registered: bool) -> float:
        """Add a step per registered slip."""
        if registered:
            self._run = 0
            self._wanted = min(self._wanted + self.step, self.max_force)
        return self._wanted


@dataclass
class Grip(GripController):
    """Raise the grip force in proportion to the evidence of slip, and lower it again afterwards.

    A slip decision belongs to the force that was commanded `latency` earlier. During a registered slip the
    force grows by ``gain * e`` per second, relative to that force, but no faster than `rate`; e, from 0 to 1,
    is the probability above the threshold. Friction equals the weight on average over a slip that begins and
    ends at rest, so the mean force of a slip just holds the object. `latency` after the slip the force
    decreases to this mean plus `margin`.

    Args:
        gain: Growth rate, 1/s.
        margin: Margin above the mean force of the latest slip, relative to that force.
        latency: Time from a command to the detector's reaction, ns. Slips closer to each other are one.
        release_rate: Rate of the decrease, relative to the force, 1/s.

    Raises:
        ParameterError: if a parameter is invalid.

    >>> scores = Scores(np.arange(5) * 10 * ms, np.array([0.1, 1.0, 1.0, 1.0, 0.1]))
    >>> Grip(force=1.0, gain=5.0, settle=0).push(scores).force
    array([1.  , 1.05, 1.1 ])
    """

    gain: float = 20.0
    margin: float = 1.0
    latency: int = 240 * ms
    release_rate: float = 4.0
    _total: float = field(default=0.0, init=False, repr=False)  # N, sum of the forces of the latest slip
    _decisions: int = field(default=0, init=False, repr=False)  # for slip, in the latest slip
    _since: int = field(default=0, init=False, repr=False)  # ns, latest decision within a slip
    # (ns, N) of each command within `latency`
    _history: deque[tuple[int, float]] = field(
        default_factory=deque[tuple[int, float]], init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("gain", "margin", "release_rate"):
            check_between("Grip", key, getattr(self, key), 0, _MOST)
        check_at_least("Grip", "latency", self.latency, 0, "ns")

    def aim(self, time: int, elapsed: float, probability: float, *, registered: bool) -> float:
        """Grow with the evidence of slip; decrease to the margin afterwards."""
        force, history = self._aim, self._history
        history.append((time, force))
        while len(history) > 1 and history[1][0] <= time - self.latency:
            history.popleft()
        earlier = history[0][1]  # N, commanded `latency` ago
        if registered:
            if time - self._since > self.latency:
                self._total, self._decisions = 0.0, 0
            span = 1 - self.threshold
            evidence = (probability - self.threshold) / span if span else 1.0
            self._total += earlier
            self._decisions += 1
            self._since = time
            return force + self.gain * evidence * earlier * elapsed
        if not self._decisions or time - self._since < self.latency:
            return force
        sufficient = self._total / self._decisions * (1 + self.margin)
        return max(force * (1 - self.release_rate * elapsed), min(sufficient, force))
