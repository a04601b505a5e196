"""How hard to grip, out of how sure a detector is of slip."""

import math
from abc import abstractmethod
from collections import deque
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from operators.batch import Commands, Scores, ms, s
from operators.errors import ParameterError
from operators.operator import Operator

_LONGEST: Final = 50 * ms  # ns, between two decisions of one slip: what is longer is a gap


@dataclass
class GripController(Operator[Scores, Commands]):
    """What rules for the grip force share: limits, the first command, and letting go.

    The first decision commands `force`: the hand closes. What is felt within `settle` of it is the touch
    itself and decides nothing. A slip is registered when `consecutive` decisions in a row say so; a NaN
    breaks the run. A command is given when it differs from the one before by `resolution`, or is a limit.

    An object that still slips when `most` has been commanded for `patience` is given up: the force falls to
    `least`, in one command, and nothing more is commanded until the operator is made afresh.

    Raises:
        ParameterError: on a value that cannot be used.
    """

    force: float = 0.5  # N, to begin with
    least: float = 0.0  # N
    most: float = 10.0  # N
    rate: float = 40.0  # N/s, at which commands rise at most
    threshold: float = 0.5  # the least probability that is a slip decision
    consecutive: int = 2  # decisions
    settle: int = 300 * ms  # ns
    patience: int = 1 * s  # ns
    resolution: float = 0.02  # N
    _asked: float = field(default=math.nan, init=False, repr=False)  # N, by the newest command
    _aim: float = field(default=0.0, init=False, repr=False)  # N
    _begun: int = field(default=0, init=False, repr=False)  # ns, of the first decision
    _before: int = field(default=0, init=False, repr=False)  # ns, of the newest decision
    _run: int = field(default=0, init=False, repr=False)  # slip decisions in a row
    _full: int = field(default=0, init=False, repr=False)  # ns that it has slipped with all force
    _given_up: bool = field(default=False, init=False, repr=False)

    def __post_init__(self) -> None:
        name = type(self).__name__
        if not 0 <= self.least <= self.force <= self.most < math.inf:
            must_be = f"from least to most, {self.least:g} to {self.most:g} N, both at least 0 and finite"
            raise ParameterError(name, "force", self.force, must_be)
        if not 0 < self.threshold <= 1:
            raise ParameterError(name, "threshold", self.threshold, "above 0 and at most 1")
        for key, unit in (("rate", "N/s"), ("resolution", "N")):
            if not getattr(self, key) > 0:
                raise ParameterError(name, key, getattr(self, key), f"above 0 {unit}")
        for key, lowest, unit in (("consecutive", 1, "decision"), ("settle", 0, "ns"), ("patience", 0, "ns")):
            if getattr(self, key) < lowest:
                raise ParameterError(name, key, getattr(self, key), f"at least {lowest} {unit}")

    @property
    def given_up(self) -> bool:
        """Whether it has let go of an object that all force did not hold."""
        return self._given_up

    def process(self, batch: Scores) -> Commands:
        """Give the commands that the decisions make."""
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
        velocity = np.full((len(rows), 6), np.nan)
        return Commands(batch.time[rows], np.array(forces), velocity, finger=batch.finger)

    @abstractmethod
    def aim(self, time: int, gone: float, probability: float, *, registered: bool) -> float:
        """The force (N) that is right now; limits are not its business.

        Args:
            time: Of the decision, ns.
            gone: Since the one before, s; 0 after a gap.
            probability: Of slip; NaN: unknown.
            registered: Whether a slip is registered.
        """

    def _decide(self, time: int, probability: float) -> float:
        """The force to command, N; NaN: none."""
        if math.isnan(self._asked):
            self._begun = self._before = time
            self._aim = self._asked = self.force
            return self.force
        if self._given_up:
            return math.nan
        since, self._before = time - self._before, time
        gone = since / s if since <= _LONGEST else 0.0
        settled = time - self._begun >= self.settle
        self._run = self._run + 1 if settled and probability >= self.threshold else 0
        registered = self._run >= self.consecutive
        if not settled:
            return math.nan
        wanted = self.aim(time, gone, probability, registered=registered)
        self._aim = min(max(wanted, self.least), self.most, self._aim + self.rate * gone)
        if registered and self._asked == self.most:
            self._full += since
            if self._full >= self.patience:
                self._given_up = True
                self._asked = self.least
                return self.least
        elif not registered:
            self._full = 0
        if self._aim == self._asked or (
            abs(self._aim - self._asked) < self.resolution and self._aim not in (self.most, self.least)
        ):
            return math.nan
        self._asked = self._aim
        return self._aim


@dataclass
class StepGrip(GripController):
    """The paper's rule: each registered slip raises the force by a step ("Under Pressure", 2021, V-B).

    A slip that lasts is registered again after `consecutive` more decisions. The force never falls. The paper
    does not say how large its step was.

    Raises:
        ParameterError: on a value that cannot be used.

    >>> scores = Scores(np.arange(6) * 10 * ms, np.array([0.1, 0.9, 0.9, 0.9, 0.9, 0.1]))
    >>> StepGrip(force=1.0, step=0.2, settle=0).push(scores).force
    array([1. , 1.2, 1.4])
    """

    step: float = 0.15  # N
    _wanted: float = field(default=0.0, init=False, repr=False)  # N

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.step > 0:
            raise ParameterError("StepGrip", "step", self.step, "above 0 N")
        self._wanted = self.force

    def aim(self, time: int, gone: float, probability: float, *, registered: bool) -> float:  # noqa: ARG002
        """A step more for each registered slip."""
        if registered:
            self._run = 0
            self._wanted = min(self._wanted + self.step, self.most)
        return self._wanted


@dataclass
class Grip(GripController):
    """Force in proportion to the evidence of slip, and no more; in shares of itself, as it knows no scale.

    While a slip is registered the force grows by ``gain * e * (1 + T / soon)`` per second, in shares of what
    it was when that slip began; T is how long it has lasted, and e how far the probability is above the
    threshold, 0 to 1. What a command does is not felt before `latency` has passed; until then a hand that
    grips harder stirs the fingertip itself: so the force is at most `reach` times what it was `latency`
    ago.

    What slips was gripped with what was commanded `latency` ago, so that force is too little. `margin` above
    the newest such force is taken to be enough: once nothing has slipped for `calm`, the force falls to
    there, but not below `keep` of what it was when the slip ended.

    Raises:
        ParameterError: on a value that cannot be used.

    >>> scores = Scores(np.arange(5) * 10 * ms, np.array([0.1, 1.0, 1.0, 1.0, 0.1]))
    >>> Grip(force=1.0, gain=10.0, settle=0).push(scores).force
    array([1.     , 1.1    , 1.20125])
    """

    gain: float = 22.0  # 1/s
    soon: int = 800 * ms  # ns, of slip, after which the force grows twice as fast
    reach: float = 4.0  # times the force of `latency` ago, at most
    margin: float = 0.5  # above the force that slipped last
    keep: float = 0.65  # of the force when a slip ends, at least
    latency: int = 160 * ms  # ns, from a command over its force to what the detector makes of it
    calm: int = 200 * ms  # ns
    ease: float = 1.5  # 1/s, of itself, that the force falls by
    _first: float = field(default=0.0, init=False, repr=False)  # N, that the slip at hand began with
    _lasted: float = field(default=0.0, init=False, repr=False)  # s, of the slip at hand
    _slipped: float = field(default=0.0, init=False, repr=False)  # N, that did not hold
    _reached: float = field(default=0.0, init=False, repr=False)  # N, when the newest slip ended
    _since: int = field(default=0, init=False, repr=False)  # ns, of the newest decision within a slip
    # ns, N: what was commanded when, `latency` back
    _given: deque[tuple[int, float]] = field(
        default_factory=deque[tuple[int, float]], init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("gain", "margin", "ease"):
            if not 0 <= getattr(self, key) < math.inf:
                raise ParameterError("Grip", key, getattr(self, key), "at least 0 and finite")
        if not 0 <= self.keep <= 1:
            raise ParameterError("Grip", "keep", self.keep, "from 0 to 1")
        if not self.reach > 1:
            raise ParameterError("Grip", "reach", self.reach, "above 1")
        for key, lowest in (("soon", 1), ("latency", 0), ("calm", 0)):
            if getattr(self, key) < lowest:
                raise ParameterError("Grip", key, getattr(self, key), f"at least {lowest} ns")

    def aim(self, time: int, gone: float, probability: float, *, registered: bool) -> float:
        """The force that evidence and margin ask for."""
        force, earlier = self._aim, self._earlier(time)
        if registered:
            if not self._lasted:
                self._first = force
            certain = 1 - self.threshold
            evidence = (probability - self.threshold) / certain if certain else 1.0
            pace = self.gain * evidence * (1 + self._lasted * s / self.soon)  # 1/s
            self._lasted += gone
            self._slipped, self._since = earlier, time
            self._reached = min(force + pace * gone * self._first, max(force, self.reach * earlier))
            return self._reached
        self._lasted = 0.0
        enough = max(self._slipped * (1 + self.margin), self._reached * self.keep)
        if not self._slipped or force <= enough or time - self._since < self.calm:
            return force
        return max(force * (1 - self.ease * gone), enough)

    def _earlier(self, time: int) -> float:
        """The force (N) that was commanded `latency` ago; keep what may be asked for later."""
        given = self._given
        given.append((time, self._aim))
        while len(given) > 1 and given[1][0] <= time - self.latency:
            given.popleft()
        return given[0][1]
