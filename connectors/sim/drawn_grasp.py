"""Simulated grasps to train on, with random objects, fingertips and grippers.

A detector trained only on strokes has learnt the motion of the arm, not of the object: it reports slip when
the load increases, at harmless blows, and when the gripper closes further. Here three of five grasps are
firm: the object is gripped, lifted, pressed and tapped, and slides only at hard blows. The others are too
weak for the object. No grasp has one of the six objects of the experiments, or their fingertip.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, Self, cast

import numpy as np

from connectors.sim.grasp import Grasp, GraspState, Tap, least_force
from connectors.sim.objects import Object
from connectors.sim.paper_plan import PaperPlan, varied
from connectors.sim.scene import Curvature, Parameters, Travel, Vibration
from connectors.sim.simulated_rig import SLIDING
from operators.batch import Touch, Truth, concat

RATE: Final = 100.0  # Hz
SECONDS: Final = 5.0  # of a grasp; it ends earlier if the object is dropped
CLOSING: Final = 1.0  # s, when the hand closes, after the baseline
FIRM: Final = 0.6  # share of firm grasps
BLOW: Final = 0.09  # m/s, of an object gripped with the least force by a blow that barely moves it
_CURVATURES: Final[tuple[Curvature, ...]] = ("plane", "sphere", "cylinder_y", "cylinder_x")
_SHARES: Final = (0.4, 0.2, 0.2, 0.2)  # more planes: half of their loaded cells read 0
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
    held, parameters, passive = draw_object(random), draw_fingertip(random), float(random.uniform(0.3, 1.0))
    least = least_force(held, parameters, passive=passive)
    gripper = _RandomGripper.draw(random, least, firm=random.random() < FIRM)
    grasp = _draw_grasp(random, held, parameters, gripper, passive)
    touches: list[Touch] = []
    states: list[GraspState] = []
    for k in range(round(SECONDS * RATE)):
        touch, state = grasp.sense(k / RATE)
        if state.dropped:
            break
        touches.append(touch)
        states.append(state)
        gripper.update(grasp, k / RATE, state.speed)
    touch = concat(Touch, touches)
    speed, force = (np.array([getattr(state, name) for state in states]) for name in ("speed", "force"))
    return touch, Truth(touch.time, speed, force, np.zeros((len(touch), 3)), finger=touch.finger)


def _draw_grasp(
    random: np.random.Generator,
    held: Object,
    parameters: Parameters,
    gripper: "_RandomGripper",
    passive: float,
) -> Grasp:
    """Draw lift, grip position, blows and vibration."""
    start = float(random.uniform(1.4, 2.4))
    lift = Travel(
        start,
        float(random.uniform(0.03, 0.08)),
        _log_uniform(random, 0.02, 0.12),
        _log_uniform(random, 0.2, 2.0),
    )
    x = float(random.uniform(-0.3, 0.3) * held.width / 2)
    y = float(random.uniform(-0.3, 0.3) * held.reach)
    momentum = held.mass * BLOW * math.sqrt(gripper.force / gripper.least)
    taps = list(_draw_taps(random, momentum, lift.start + float(random.uniform(0.4, 1.6))))
    vibration = Vibration(
        _log_uniform(random, 2e-6, 1e-4), float(random.uniform(4, 16)), float(random.uniform(0, 360))
    )
    grasp = Grasp(
        held,
        parameters,
        int(random.integers(2**31)),
        taps=taps,
        lift=lift if random.random() < 0.9 else None,
        passive=passive,
        grip=(x, y),
        vibration=vibration,
    )
    grasp.press(gripper.force, CLOSING, gripper.rate)
    return grasp


def draw_object(random: np.random.Generator) -> Object:
    """Draw an object from ranges wider than those of the six objects."""
    curvature = cast("Curvature", random.choice(_CURVATURES, p=_SHARES))
    radius = _log_uniform(random, 0.02, 0.09)
    round_ = curvature in ("sphere", "cylinder_y")
    length = 2 * radius if curvature in ("sphere", "cylinder_x") else _log_uniform(random, 0.07, 0.3)
    return Object(
        "drawn",
        curvature,
        radius=math.inf if curvature == "plane" else radius,
        width=2 * radius if round_ else _log_uniform(random, 0.04, 0.15),
        length=length,
        mass=_log_uniform(random, 0.08, 1.0),
        friction=_log_uniform(random, 0.4, 1.8),
        texture=float(random.uniform(0.0, 1.35)),
        stiffness=_log_uniform(random, 0.2, 1.3),
    )


def draw_fingertip(random: np.random.Generator) -> Parameters:
    """Draw a fingertip of the wide plan, with further constants varied and its own noise."""
    scene = next(PaperPlan(vary=varied).scenes(int(random.integers(2**31))))
    fingertip = scene.parameters
    changed = {
        name: getattr(fingertip, name) * math.exp(spread * random.standard_normal())
        for name, spread in _SPREADS.items()
    }
    return replace(fingertip, **changed, noise=_log_uniform(random, 0.3, 1.5))


def _draw_taps(random: np.random.Generator, momentum: float, start: float) -> Iterator[Tap]:
    """Draw blows around a momentum (N s), from harmless ones to some that move the object by centimetres."""
    instant = start
    while random.random() < 0.9 and instant < SECONDS - 0.3:
        drawn = momentum * _log_uniform(random, 0.15, 4.0)
        if random.random() < 0.5:
            yield Tap(instant, drawn, "top", _log_uniform(random, 0.004, 0.02))
        else:
            heading = float(random.choice([-1, 1]))
            yield Tap(instant, drawn * heading, "side", _log_uniform(random, 0.004, 0.02))
        instant += float(random.uniform(0.25, 1.2))


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
    def draw(cls, random: np.random.Generator, least: float, *, firm: bool) -> Self:
        """Draw a gripper for an object that `least` (N) holds; a firm one always holds it."""
        low = _log_uniform(random, 0.01, 0.2)
        return cls(
            random,
            least,
            force=least * (_log_uniform(random, 1.2, 4.0) if firm else _log_uniform(random, 0.3, 1.2)),
            rate=_log_uniform(random, 2.0, 60.0),
            lag=_log_uniform(random, 0.01, 0.2),
            tail=_log_uniform(random, 0.01, 0.3),
            steps=(low, low * _log_uniform(random, 1.0, 3.0)),
            restless=_log_uniform(random, 0.1, 4.0),
            floor=1.15 * least if firm else 0.0,
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
            more = max(_log_uniform(self.random, *self.steps) * self.force, 0.02 * self.least)
            self.force = min(self.force + more, 12 * self.least)
            grasp.press(self.force, instant, self.rate)

    def _change(self, grasp: Grasp, instant: float) -> None:
        """Change the force at random."""
        random, rate = self.random, self.rate * float(self.random.choice([1.0, 1.0, 0.2, 4.0]))
        self._next_change = instant + float(random.exponential(1 / self.restless))
        match random.choice(4):
            case 0:
                self.force *= 1 + _log_uniform(random, 0.02, 0.4)
            case 1:
                self.force *= 1 - _log_uniform(random, 0.02, 0.3)
            case 2:
                self.force = self.least * _log_uniform(random, 0.9, 5.0)
            case _:  # slowly down, until the object slips unless the grasp is firm
                self.force *= 0.4
                rate = self.force * _log_uniform(random, 0.05, 1.0)
        self.force = max(self.force, self.floor)
        grasp.press(self.force, instant, rate)


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** random.uniform())
