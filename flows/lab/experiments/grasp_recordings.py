"""Simulated grasps to train on, with random objects and grippers, labelled by true sliding.

A detector trained only on strokes has learnt the motion of the arm, not of the object: it reports slip when
the load increases, at harmless blows, and when the gripper closes further. Here each recording has its own
object, fingertip and gripper, drawn from wide ranges. None has one of the six objects of the experiments.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Self, cast

import numpy as np

from connectors.sim.grasp import Grasp, least_force
from connectors.sim.grasp_actions import Lift, Tap
from connectors.sim.objects import Object
from connectors.sim.paper_plan import PaperPlan, varied
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Curvature, Scene, Vibration
from connectors.sim.truth import SLIDING
from flows.learn.evaluation.event_metrics import filled
from flows.learn.labelled_recordings import WARM_UP, LabelledRecording
from operators import Zero
from operators.batch import SLIP, STATIC, UNKNOWN, Codes, Flags, Touch, Zeroed, concat, ms

RATE: Final = 100.0  # Hz
SECONDS: Final = 5.0  # of a recording; it ends earlier if the object is dropped
STUCK: Final = 50 * ms  # ns; a shorter stick is part of a slip
CREEP: Final = 0.5  # of the speed that counts as slip; between the two the label is unknown
_CURVATURES: Final[tuple[Curvature, ...]] = ("plane", "sphere", "cylinder_y", "cylinder_x")
_SHARES: Final = (0.4, 0.2, 0.2, 0.2)  # more planes: half of their loaded cells read 0
_SPLITS: Final = ("train",) * 8 + ("validation", "test")


def grasp_recordings(count: int, seed: int) -> Iterator[LabelledRecording]:
    """Simulate grasps, the same for a seed; 80 % for training, 10 % for validation, 10 % for the test."""
    for number in range(count):
        name, split = f"grasp-{seed}-{number:04}", _SPLITS[number % len(_SPLITS)]
        yield _recording(np.random.default_rng([seed, 11, number]), name, split)


def sliding_labels(sliding: Flags, pause: int = STUCK) -> Codes:
    """Return labels (n,) by true sliding (n,); pauses shorter than `pause` (ns) are slip."""
    return np.where(filled(sliding, pause), SLIP, STATIC).astype(np.int8)


def _recording(random: np.random.Generator, name: str, split: str) -> LabelledRecording:
    held, parameters = draw_object(random), _draw_fingertip(random)
    gripper = _RandomGripper.draw(random, least_force(held, parameters))
    grasp = _draw_grasp(random, held, parameters, gripper)
    touches: list[Touch] = []
    speeds: list[float] = []
    for k in range(round(SECONDS * RATE)):
        touch, truth = grasp.sense(k / RATE)
        if truth.dropped:
            break
        touches.append(touch)
        speeds.append(truth.speed)
        gripper.update(grasp, k / RATE, truth.speed)
    zeroed = concat(Zeroed, [Zero().push(concat(Touch, touches))])
    speed = np.array(speeds)  # (n,) m/s
    sliding = sliding_labels(speed > SLIDING)
    label = np.where((sliding == STATIC) & (speed > CREEP * SLIDING), np.int8(UNKNOWN), sliding)
    return LabelledRecording(
        zeroed.counts,
        label,
        held.curvature,
        valid=zeroed.valid,
        sliding=sliding,
        zeroing=WARM_UP + 1,
        name=name,
        split=split,
    )


def _draw_grasp(
    random: np.random.Generator, held: Object, parameters: Parameters, gripper: "_RandomGripper"
) -> Grasp:
    """Draw lift, grip position, blows and vibration."""
    start = float(random.uniform(1.4, 2.4))
    lift = Lift(
        start,
        float(random.uniform(0.03, 0.08)),
        _log_uniform(random, 0.02, 0.12),
        _log_uniform(random, 0.2, 2.0),
    )
    x = float(random.uniform(-0.3, 0.3) * held.width / 2)
    y = float(random.uniform(-0.3, 0.3) * held.reach)
    taps = list(_draw_taps(random, held.mass, lift.end + float(random.uniform(0.0, 0.6))))
    vibration = Vibration(
        _log_uniform(random, 2e-6, 1e-4), float(random.uniform(4, 16)), float(random.uniform(0, 360))
    )
    return Grasp(
        held,
        parameters,
        int(random.integers(2**31)),
        force=gripper.force,
        rate=gripper.rate,
        taps=taps,
        lift=lift if random.random() < 0.9 else None,  # noqa: PLR2004 - one in ten stays on the table
        passive=float(random.uniform(0.3, 1.0)),
        grip=(x, y),
        vibration=vibration,
    )


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


def _draw_fingertip(random: np.random.Generator) -> Parameters:
    """Draw the fitted fingertip, or one of the wide plan."""
    plain = next(PaperPlan().scenes(int(random.integers(2**31))))
    scene: Scene = varied(plain, random) if random.random() < 0.6 else plain  # noqa: PLR2004 - a share
    return scene.parameters


def _draw_taps(random: np.random.Generator, mass: float, start: float) -> Iterator[Tap]:
    """Draw blows, from harmless ones to some that move the object by centimetres."""
    instant = start
    while random.random() < 0.75 and instant < SECONDS - 0.3:  # noqa: PLR2004 - three on average
        momentum = mass * _log_uniform(random, 0.01, 0.5)
        if random.random() < 0.5:  # noqa: PLR2004 - half of them
            yield Tap(instant, momentum, "top", _log_uniform(random, 0.004, 0.02))
        else:
            heading = float(random.choice([-1, 1]))
            yield Tap(instant, momentum * heading, "side", _log_uniform(random, 0.004, 0.02))
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
    firm: tuple[float, float]  # range of a step of the reaction, relative to the force
    _slides_since: float = math.nan  # s; NaN: not sliding
    _react_until: float = -math.inf  # s
    _next_step: float = 0.0  # s, of the reaction
    _next_change: float = 1.4  # s, at random

    @classmethod
    def draw(cls, random: np.random.Generator, least: float) -> Self:
        """Draw a gripper for an object that `least` (N) holds."""
        return cls(
            random,
            least,
            force=least * _log_uniform(random, 0.3, 2.2),
            rate=_log_uniform(random, 2.0, 60.0),
            lag=_log_uniform(random, 0.01, 0.2),
            tail=_log_uniform(random, 0.01, 0.3),
            firm=(low := _log_uniform(random, 0.01, 0.2), low * _log_uniform(random, 1.0, 3.0)),
            restless=_log_uniform(random, 0.1, 4.0),
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
            more = max(_log_uniform(self.random, *self.firm) * self.force, 0.02 * self.least)
            self.force = min(self.force + more, 12 * self.least)
            grasp.press(self.force, instant, self.rate)

    def _change(self, grasp: Grasp, instant: float) -> None:
        """Change the force at random."""
        random = self.random
        self._next_change = instant + float(random.exponential(1 / self.restless))
        match random.choice(4):
            case 0:
                self.force *= 1 + _log_uniform(random, 0.02, 0.4)
            case 1:
                self.force *= 1 - _log_uniform(random, 0.02, 0.3)
            case 2:
                self.force = self.least * _log_uniform(random, 0.9, 5.0)
            case _:  # slowly down, until the object slips
                self.force *= 0.4
                grasp.press(self.force, instant, self.force * _log_uniform(random, 0.05, 1.0))
                return
        grasp.press(self.force, instant, self.rate * float(random.choice([1.0, 1.0, 0.2, 4.0])))


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** random.uniform())
