"""Simulated grasps to train on, with random objects, fingertips and grippers.

A detector trained only on strokes has learnt the motion of the arm, not of the object: it reports slip when
the load increases, at harmless blows, and when the gripper closes further. Two of three grasps here are firm:
the object is gripped, lifted and hit, or held by a restless gripper. The others are too weak for the object,
and the gripper reacts. The course is that of the robot experiments, but no grasp has one of their six objects
or their fingertip.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, Self, cast

import numpy as np

from connectors.sim.grasp import Grasp, GraspState, Tap, blow_momentum, grip_model, least_force, surface
from connectors.sim.objects import Object
from connectors.sim.paper_plan import PaperPlan, varied
from connectors.sim.scene import Parameters, Travel, Vibration, log_uniform
from connectors.sim.simulated_rig import SLIDING
from operators.batch import Curvature, Touch, Truth, concat

RATE: Final = 100.0  # Hz
SECONDS: Final = 6.5  # of a grasp; it ends earlier if the object is dropped
CLOSING: Final = 1.0  # s, when the hand closes, after the baseline
KINDS: Final = {"hit": 0.5, "weak": 0.35, "restless": 0.15}  # shares of grasps
SOFT_SHARE: Final = 0.35  # of blows that are to move nothing
STRONGEST: Final = 10.0  # N, of the gripper; assumed
OFFSET: Final = (0.004, 0.006)  # m, largest offset of the grip from the object's centre in x and y; assumed
_SURFACE_SHARES: Final = (0.4, 0.2, 0.2, 0.2)  # more planes: half of their loaded cells read 0
# constants of the fingertip that differ between grasps, but not between strokes: spread of their logarithm
_SPREADS: Final = {
    "tilt_stiffness": 0.5,
    "lever": 0.3,
    "shear_stiffness": 0.3,
    "twist_stiffness": 0.3,
    "depth": 0.1,
    "relaxation": 0.3,
}


def simulate_grasp(seed: int, number: int) -> tuple[Touch, Truth]:
    """Simulate one grasp of a series, from an open gripper on; the same for the same seed and number.

    Returns:
        Raw counts and the true sliding and force, with a row for each sample, from time 0 on.
    """
    random = np.random.default_rng([seed, 11, number])
    kind = random.choice(list(KINDS), p=list(KINDS.values()))
    grasp, gripper = _draw_grasp(random, kind)
    touches: list[Touch] = []
    states: list[GraspState] = []
    for k in range(round(SECONDS * RATE)):
        touch, state = grasp.sense(k / RATE)
        if state.dropped:
            break
        touches.append(touch)
        states.append(state)
        if kind != "hit":
            gripper.update(grasp, k / RATE, state.speed)
    touch = concat(Touch, touches)
    speed, force = (np.array([getattr(state, name) for state in states]) for name in ("speed", "force"))
    return touch, Truth(touch.time, speed, force, np.zeros((len(touch), 3)), finger=touch.finger)


def _draw_grasp(random: np.random.Generator, kind: str) -> tuple[Grasp, "_RandomGripper"]:
    """Draw an object, a gripper, and the lift, grip position, blows and vibration."""
    while True:
        held, parameters = draw_object(random), draw_fingertip(random)
        passive = parameters.static_friction * float(random.uniform(0.7, 1.1))
        least = least_force(held, parameters, passive=passive)
        if 3 * least < STRONGEST:
            break
    gripper = _RandomGripper.draw(random, least, kind)
    start = float(random.uniform(1.9, 2.6))
    distance, speed = float(random.uniform(0.03, 0.07)), log_uniform(random, 0.025, 0.1)
    lift = Travel(start, distance, speed, log_uniform(random, 0.02, 1.2))
    position = draw_position(random, held, most=1.2)
    grasp = Grasp(
        held,
        parameters,
        int(random.integers(2**31)),
        taps=list(_draw_taps(random, held, parameters, position, gripper, lift.end))
        if kind != "weak"
        else (),
        lift=lift,
        passive=passive,
        grip=position,
        vibration=Vibration(
            log_uniform(random, 5e-6, 5e-5), float(random.uniform(5, 14)), float(random.uniform(0, 360))
        ),
    )
    grasp.press(gripper.force, CLOSING, gripper.rate)
    return grasp, gripper


def draw_position(random: np.random.Generator, held: Object, *, most: float = 1.0) -> tuple[float, float]:
    """Draw where the pad grips an object, relative to its centre (m, m); `most` is a factor of the range."""
    x, y = (random.uniform(-most, most, 2) * np.minimum(OFFSET, (held.width / 4, held.reach / 2))).tolist()
    return x, y


def draw_object(random: np.random.Generator) -> Object:
    """Draw an object from ranges wider than those of the six objects."""
    curvature = cast("Curvature", random.choice(PaperPlan().surfaces, p=_SURFACE_SHARES))
    radius = log_uniform(random, 0.02, 0.09)
    round_ = curvature in ("sphere", "cylinder_y")
    length = 2 * radius if curvature in ("sphere", "cylinder_x") else log_uniform(random, 0.07, 0.3)
    return Object(
        curvature,
        radius=math.inf if curvature == "plane" else radius,
        width=2 * radius if round_ else log_uniform(random, 0.04, 0.15),
        length=length,
        mass=log_uniform(random, 0.08, 1.0),
        friction=log_uniform(random, 0.4, 1.8),
        texture=float(random.uniform(0.0, 1.35)),
        stiffness=log_uniform(random, 0.2, 1.3),
    )


def draw_fingertip(random: np.random.Generator) -> Parameters:
    """Draw a fingertip of the wide plan, with further constants varied and its own noise."""
    scene = next(PaperPlan(vary=varied).scenes(int(random.integers(2**31))))
    fingertip = scene.parameters
    changed = {
        name: getattr(fingertip, name) * math.exp(spread * random.standard_normal())
        for name, spread in _SPREADS.items()
    }
    return replace(fingertip, **changed, noise=log_uniform(random, 0.3, 1.5))


def _draw_taps(
    random: np.random.Generator,
    held: Object,
    parameters: Parameters,
    position: tuple[float, float],
    gripper: "_RandomGripper",
    lifted: float,
) -> Iterator[Tap]:
    """Draw blows after the lift, from harmless ones to some that move the object by millimetres."""
    grip, firm = grip_model(held, surface(held, parameters), position), gripper.force / gripper.least
    instant = lifted + float(random.uniform(0.3, 1.0))
    while instant < SECONDS - 0.5:
        top = random.random() < 0.5
        excess = firm - 1 if top else math.sqrt(firm**2 - 1)
        momentum = blow_momentum(grip, firm, excess, log_uniform(random, 0.0003, 0.006))
        if random.random() < SOFT_SHARE:
            momentum *= log_uniform(random, 0.05, 0.6)
        seconds = 0.01 if random.random() < 0.6 else log_uniform(random, 0.005, 0.02)
        if top:
            yield Tap(instant, momentum, "top", seconds)
        else:
            yield Tap(instant, momentum * float(random.choice([-1, 1])), "side", seconds)
        instant += float(random.uniform(0.45, 1.1))


@dataclass
class _RandomGripper:
    """A gripper that changes its force at random, and reacts to sliding after a random delay."""

    random: np.random.Generator
    least: float  # N, that holds the object
    force: float  # N, commanded; at first the initial force
    rate: float  # N/s
    lag: float  # s, from sliding to the reaction
    tail: float  # s, of the reaction after the sliding
    restless: float  # 1/s, rate of random changes of force
    steps: tuple[float, float]  # range of a step of the reaction, relative to the force
    floor: float  # N, lowest force; above `least` if the grasp is firm
    _slides_since: float = math.nan  # s; NaN: not sliding
    _react_until: float = -math.inf  # s
    _next_step: float = 0.0  # s, of the reaction
    _next_change: float = 1.4  # s, at random

    @classmethod
    def draw(cls, random: np.random.Generator, least: float, kind: str) -> Self:
        """Draw a gripper for an object that `least` (N) holds; only a weak one may let it slip."""
        low = log_uniform(random, 0.01, 0.2)
        firm = kind != "weak"
        return cls(
            random,
            least,
            force=least * (log_uniform(random, 1.8, 4.0) if firm else float(random.uniform(0.3, 1.05))),
            rate=10.0 if random.random() < 0.6 else log_uniform(random, 4.0, 40.0),
            lag=log_uniform(random, 0.01, 0.2),
            tail=log_uniform(random, 0.01, 0.3),
            steps=(low, low * log_uniform(random, 1.0, 3.0)),
            restless=log_uniform(random, 0.1, 4.0) * (1 if firm else 0.15),
            floor=1.5 * least if firm else 0.0,
        )

    def update(self, grasp: Grasp, instant: float, speed: float) -> None:
        """Observe the sliding speed (m/s) at an instant (s), and change the force if it is time."""
        if speed <= SLIDING:
            self._slides_since = math.nan
        elif math.isnan(self._slides_since):
            self._slides_since = instant
        if instant - self._slides_since > self.lag:
            self._react_until = instant + self.tail
        if instant <= self._react_until:
            self._react(grasp, instant)
        elif instant > self._next_change:
            self._change(grasp, instant)

    def _react(self, grasp: Grasp, instant: float) -> None:
        """Increase the force by a step."""
        if instant >= self._next_step:
            self._next_step = instant + float(self.random.choice([0.01, 0.01, 0.02, 0.05]))
            more = max(log_uniform(self.random, *self.steps) * self.force, 0.02 * self.least)
            self.force = min(self.force + more, 12 * self.least)
            grasp.press(self.force, instant, self.rate)

    def _change(self, grasp: Grasp, instant: float) -> None:
        """Change the force at random."""
        random, rate = self.random, self.rate * float(self.random.choice([1.0, 1.0, 0.2, 4.0]))
        self._next_change = instant + float(random.exponential(1 / self.restless))
        match random.choice(4):
            case 0:
                self.force *= 1 + log_uniform(random, 0.02, 0.4)
            case 1:
                self.force *= 1 - log_uniform(random, 0.02, 0.3)
            case 2:
                self.force = self.least * log_uniform(random, 0.9, 5.0)
            case _:  # slowly down, until the object slips unless the grasp is firm
                self.force *= 0.4
                rate = self.force * log_uniform(random, 0.05, 1.0)
        self.force = max(self.force, self.floor)
        grasp.press(self.force, instant, rate)
