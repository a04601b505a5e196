"""One trial of an experiment: a simulated grasp, a detector and a grip controller, sample by sample."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from connectors.gripper.robotiq import FULL, PACE, SETTLE
from connectors.sim.drawn_grasp import STRONGEST, draw_fingertip, draw_object, draw_position
from connectors.sim.grasp import Grasp, GraspState, Tap, least_force
from connectors.sim.objects import OBJECTS, Object
from connectors.sim.scene import Parameters, Travel, Vibration
from connectors.sim.simulated_rig import SLIDING
from operators import Score, Zero
from operators.batch import BAROMETERS, Counts, Flags, Reals, Touch, Zeroed, s
from operators.detectors import Detector
from operators.grip import GripController

BASELINE: Final = 1.0  # s with an open gripper before it closes
SPREAD: Final = 0.1  # mass and friction vary by +-10 % from trial to trial; assumed
VIBRATION: Final = 2e-5  # m, of the gripper, at 6.5 or 12 Hz as in the paper's recordings; amplitude assumed

FIRM: Final = (2.6, 3.2)  # range of a firm grip's force, relative to the least; no finger slides in a lift
FIRM_LIFT: Final = Travel(2.0)  # of a firm grip, until 3.1 s
HELD: Final = 4.0  # s; a firm grip has been lifted and held undisturbed
PHASES: Final = {  # s, starts of the phases of a firm lift
    "closing": BASELINE,
    "load transfer": FIRM_LIFT.start,
    "cruising": FIRM_LIFT.start + 0.4,
    "stopping": FIRM_LIFT.end - 0.1,
    "holding": FIRM_LIFT.end + 0.3,
}
STILL: Final = 0.1  # mm; a shorter slide of every finger is not slip
MOVED: Final = 0.5  # mm; a longer slide of the pad is a slip; anything between may be judged either way
PROMPT: Final = 0.2  # s; a slip must be registered within this time
FINGERTIP: Final = Parameters()  # with the six objects; no training grasp has it
RANDOM: Final = "random"  # objects and fingertips
SCANS: Final = 100  # samples of the open gripper at least: a detector's first window

# A Robotiq 3-Finger Gripper grips with at least 15 N, more than seven times what holds the objects of this
# scene, and cannot reduce its force without opening. The model has its steps, refresh rate and delay, but
# for small forces, and can reduce them.
LATENCY: Final = 0.008  # s: 3 ms to convert, 4 ms to read on a 100 kHz bus, 1 ms from command to gripper
SPAN: Final = STRONGEST  # N, for the 255 steps of its register


@dataclass(frozen=True, slots=True)
class Conditions:
    """Settings shared by all trials of an experiment; factors are relative to nominal."""

    delay: float = 0.0  # s, added to the latency of the gripper
    rate: float = 100.0  # Hz, of the samples
    friction: float = 1.0  # factor
    mass: float = 1.0  # factor
    stiffness: float = 1.0  # factor of the normal contact stiffness
    tilt: float = 1.0  # factor of the tilt stiffness of the pad


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a trial."""

    ending: str
    success: bool
    metrics: Mapping[str, float]  # NaN: unknown


@dataclass(frozen=True, slots=True)
class Trial:
    """The random draw of one trial: object, grip position, firm force and vibration."""

    held: Object  # with the friction and mass of the trial
    fingertip: Parameters
    seed: int
    position: tuple[float, float]  # m, of the grip relative to the object's centre
    firm: float  # force of a firm grip, relative to the least that holds
    vibration: Vibration
    conditions: Conditions

    @classmethod
    def draw(cls, name: str, seed: int, conditions: Conditions) -> Self:
        """Draw the trial of a seed with one of the six objects; it is the same for every detector and rule.

        `RANDOM` draws object and fingertip from the ranges of the training grasps, with other seeds. Objects
        that the gripper cannot hold firmly are left out.
        """
        if name != RANDOM:
            return cls._draw(OBJECTS[name], FINGERTIP, seed, conditions)
        random = np.random.default_rng([seed, 13])
        while True:
            held, fingertip = draw_object(random), draw_fingertip(random)
            if least_force(held, fingertip) * FIRM[1] <= SPAN:
                return cls._draw(held, fingertip, seed, conditions)

    @classmethod
    def _draw(cls, held: Object, fingertip: Parameters, seed: int, conditions: Conditions) -> Self:
        random = np.random.default_rng([seed, 7])
        friction, mass = (
            factor * float(random.uniform(1 - SPREAD, 1 + SPREAD))
            for factor in (conditions.friction, conditions.mass)
        )
        position = draw_position(random, held)
        vibration = Vibration(VIBRATION, float(random.choice([6.5, 12.0])), float(random.uniform(0, 360)))
        held = replace(
            held,
            friction=held.friction * friction,
            mass=held.mass * mass,
            stiffness=held.stiffness * conditions.stiffness,
        )
        fingertip = replace(fingertip, tilt_stiffness=fingertip.tilt_stiffness * conditions.tilt)
        firm = float(random.uniform(*FIRM))
        return cls(held, fingertip, seed, position, firm, vibration, conditions)

    @property
    def least_force(self) -> float:
        """Least force that holds the object (N)."""
        return least_force(self.held, self.fingertip)

    @property
    def expected_force(self) -> float:
        """Least force under nominal friction and mass (N), as a robot would assume."""
        return self.least_force * self.conditions.friction / self.conditions.mass

    def grasp(self, lift: Travel, taps: Sequence[Tap] = ()) -> Grasp:
        """Return the simulated grasp: an open gripper around the object, which is then lifted and tapped."""
        return Grasp(
            self.held,
            self.fingertip,
            self.seed,
            lift=lift,
            taps=taps,
            grip=self.position,
            vibration=self.vibration,
        )

    def hold(self, taps: Sequence[Tap], seconds: float) -> "Trace":
        """Simulate a firm lift with constant force, without a detector: `Trace.scored` adds its scores."""
        grasp = self.grasp(FIRM_LIFT, taps)
        force = quantize(self.firm * self.least_force)  # N
        grasp.press(force, BASELINE - 1 / SCANS)  # when a controller first commands
        return simulate(grasp, _instants(self.conditions, SCANS, seconds))


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Samples of a trial: the simulated truth, the detector's scores and the commands."""

    t: Reals  # (n,) s
    counts: Counts  # (n, 6) relative to the open gripper
    probability: Reals  # (n,) of slip; NaN: no score
    force: Reals  # (n,) N, normal
    slide: Reals  # (n,) m, distance of the object from where it was gripped
    speed: Reals  # (n,) m/s, sliding of the pad
    fastest: Reals  # (n,) m/s, sliding of the finger that slides fastest: the pad or a passive one
    height: Reals  # (n,) m, of the object
    hand: Reals  # (n,) m, height of the gripper
    on_table: Flags  # (n,)
    dropped: Flags  # (n,)

    def between(self, start: float, end: float) -> slice:
        """Return the samples from `start` to `end` (s)."""
        first, last = np.searchsorted(self.t, [start, end]).tolist()
        return slice(first, last)

    def scored(self, detector: Detector) -> Self:
        """Return the trace with the scores of a detector, as a live flow computes them."""
        time, valid = np.rint(self.t * s).astype(np.int64), np.ones(self.counts.shape, np.bool_)
        zeroed = Zeroed(time, self.counts, np.zeros_like(self.counts), valid)
        scores = Score(detector).push(zeroed)
        probability = np.concatenate((np.full(len(self.t) - len(scores), np.nan), scores.probability))
        return replace(self, probability=probability)

    def registered(self, rule: GripController) -> Flags:
        """Return the mask (n,) of registered slip: the last `rule.consecutive` scores reach the threshold.

        Scores before the gripper has closed do not count.
        """
        settled = self.t > BASELINE + rule.settle / s
        slip = ((self.probability >= rule.threshold) & settled).astype(np.intp)
        count = np.convolve(slip, np.ones(rule.consecutive, np.intp))[: len(slip)]
        registered: Flags = count >= rule.consecutive
        return registered

    def onsets(self, rule: GripController) -> Reals:
        """Return the times (s) at which a slip becomes registered; (k,)."""
        now = self.registered(rule)
        return self.t[now & ~np.concatenate(([False], now[:-1]))]

    def false_slips(self, rule: GripController) -> dict[str, int]:
        """Return the metrics of slips registered in a firm lift without a slip of any finger just before.

        ``false_firm`` is 1 if there are any, ``false PHASE`` their number in each phase.
        """

        def slipped(onset: float) -> bool:
            rows = self.between(onset - PROMPT, onset + 0.5 / SCANS)
            return self.travel(rows, self.fastest) >= STILL and float(self.fastest[rows].max()) > SLIDING

        false = [onset for onset in self.onsets(rule).tolist() if not slipped(onset)]
        counts, _ = np.histogram(false, [*PHASES.values(), HELD])
        by_phase = {f"false {phase}": count for phase, count in zip(PHASES, counts.tolist(), strict=True)}
        return {"false_firm": int(counts.any()), **by_phase}

    def travel(self, rows: slice, speed: Reals | None = None) -> float:
        """Return how far a finger slid in some samples (mm), there and back; by default the pad."""
        speed = self.speed if speed is None else speed
        return 1000 * float(speed[rows] @ np.diff(self.t, prepend=0.0)[rows])


def effect(instant: float, delay: float = 0.0) -> float:
    """Return the time (s) at which the command for a sample taken at `instant` takes effect.

    The gripper reads its registers once in `PACE`, and takes `SETTLE` from a request to its effect.
    """
    return math.ceil((instant + LATENCY + delay) / PACE - 1e-9) * PACE + SETTLE


def quantize(force: float) -> float:
    """Return the force (N) of the gripper's highest step that does not exceed the commanded one."""
    return math.floor(min(max(force, 0.0), SPAN) / SPAN * FULL + 1e-6) / FULL * SPAN


def control_trial(
    grasp: Grasp, detector: Detector, rule: GripController, conditions: Conditions, seconds: float
) -> Trace:
    """Simulate a grasp whose force a rule controls by the scores of a detector, as the flow `lift` does.

    The grasp begins with an open gripper, sampled at least as often as the detector's first score needs.
    """
    instants = _instants(conditions, max(SCANS, detector.length), seconds)
    stamps, probability = np.rint(instants * s).astype(np.int64), np.full(len(instants), np.nan)
    zero, score = Zero(scans=int(np.sum(instants < BASELINE))), Score(detector)
    target = 0.0  # N, of the gripper

    def react(touch: Touch) -> None:
        nonlocal target
        scores = score.push(zero.push(touch))
        probability[np.searchsorted(stamps, scores.time)] = scores.probability
        commands = rule.push(scores)
        for time, force in zip(commands.time.tolist(), commands.force.tolist(), strict=True):
            if (step := quantize(force)) != target:
                target = step
                grasp.press(target, effect(time / s, conditions.delay))

    return replace(simulate(grasp, instants, react), probability=probability)


def _instants(conditions: Conditions, scans: int, seconds: float) -> Reals:
    """Return the times (n,) (s) of the samples: `scans` or more of the open gripper, then the others."""
    waiting = round(conditions.rate * BASELINE)
    closed, opened = np.arange(waiting, seconds * conditions.rate) / conditions.rate, max(waiting, scans)
    return np.concatenate((np.arange(opened) / opened * BASELINE, closed))


def simulate(grasp: Grasp, instants: Reals, react: Callable[[Touch], object] = lambda _touch: None) -> Trace:
    """Sample a grasp at instants (n,) (s), and call `react` with each sample."""
    truth, counts = list[GraspState](), np.zeros((len(instants), BAROMETERS), np.int16)
    for k, instant in enumerate(instants.tolist()):
        touch, held = grasp.sense(instant)
        truth.append(held)
        counts[k] = touch.counts[0]
        react(touch)
    base = np.rint(np.median(counts[instants < BASELINE], axis=0)).astype(np.int16)
    same = ("force", "speed", "height", "hand", "on_table", "dropped")
    return Trace(
        t=instants,
        counts=counts - base,
        probability=np.full(len(instants), np.nan),
        slide=np.array([np.hypot(held.slide_x, held.slide_y) for held in truth]),
        fastest=np.array([max(held.speed, held.passive_speed) for held in truth]),
        **{name: np.array([getattr(held, name) for held in truth]) for name in same},
    )
