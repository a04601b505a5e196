"""Recordings of grasps to learn from: many objects, many hands, labelled by what truly slides.

A detector that has only seen strokes knows what the arm does, not what the object does: it calls it slip when
load is taken over, when a blow does no harm, and when the hand grips harder. Here each recording has an
object, a fingertip and a hand of its own, drawn from wide ranges. None has one of the six that are judged.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, cast

import numpy as np

from connectors.sim.grasp import Grasp
from connectors.sim.holding import least_force
from connectors.sim.lift_motion import Lift
from connectors.sim.mallet import Tap
from connectors.sim.objects import Object
from connectors.sim.paper_plan import Collection
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import NOISE, Curvature, Scene, Vibration
from connectors.sim.truth import SLIDING
from connectors.sim.variety import varied
from flows.learn.evaluation.event_metrics import filled
from flows.learn.labelled_recordings import WARM_UP, LabelledRecording
from operators import Zero
from operators.batch import SLIP, STATIC, UNKNOWN, Codes, Flags, Touch, Zeroed, concat, ms

RATE: Final = 100.0  # Hz
SECONDS: Final = 5.0  # of a recording, unless its object is dropped before
STUCK: Final = 50 * ms  # ns; a shorter stick is a part of a slip
CREEPS: Final = 0.5  # of the speed that is slip: between the two nobody says what it is
_CURVATURES: Final[tuple[Curvature, ...]] = ("plane", "sphere", "cylinder_y", "cylinder_x")
_SHARES: Final = (0.4, 0.2, 0.2, 0.2)  # planes feel the least: loaded, half of their cells read 0
_SPLITS: Final = ("train",) * 8 + ("validation", "test")


def handled(count: int, seed: int) -> Iterator[LabelledRecording]:
    """Recordings of grasps, the same for a seed: eight of ten train, one validates, one tests."""
    for number in range(count):
        yield _recorded(_random(number, seed), f"grasp-{seed}-{number:04}", _SPLITS[number % len(_SPLITS)])


def things(count: int, seed: int) -> Iterator[Object]:
    """Objects as the recordings of a seed have them."""
    for number in range(count):
        yield _thing(_random(number, seed))


def by_sliding(sliding: Flags, pause: int = STUCK) -> Codes:
    """Labels (n,) by what truly slid (n,); pauses of less than `pause` ns go on."""
    return np.where(filled(sliding, pause), SLIP, STATIC).astype(np.int8)


def _random(number: int, seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, 11, number])


def _recorded(random: np.random.Generator, name: str, split: str) -> LabelledRecording:
    thing, parameters = _thing(random), _fingertip(random)
    mass = thing.mass
    least = least_force(thing, parameters)
    hand = _Hand.drawn(random, least)
    up = float(random.uniform(1.4, 2.4))
    lift = Lift(
        up, float(random.uniform(0.03, 0.08)), _between(random, 0.02, 0.12), _between(random, 0.2, 2.0)
    )
    grip = float(random.uniform(-0.3, 0.3) * thing.width / 2), float(random.uniform(-0.3, 0.3) * thing.reach)
    taps = list(_taps(random, mass, lift.end + float(random.uniform(0.0, 0.6))))
    shaking = Vibration(
        _between(random, 2e-6, 1e-4), float(random.uniform(4, 16)), float(random.uniform(0, 360))
    )
    grasp = Grasp(
        thing,
        parameters,
        int(random.integers(2**31)),
        force=hand.force,
        rate=hand.rate,
        taps=taps,
        lift=lift if random.random() < 0.9 else None,  # noqa: PLR2004 - a few only stand there
        passive=float(random.uniform(0.3, 1.0)),
        grip=grip,
        vibration=shaking,
    )
    touches: list[Touch] = []
    speed: list[float] = []
    for k in range(round(SECONDS * RATE)):
        touch, held = grasp.sense(k / RATE)
        if held.dropped:
            break
        touches.append(touch)
        speed.append(held.speed)
        hand.turn(grasp, k / RATE, held.speed)
    zeroed = concat(Zeroed, [Zero().push(concat(Touch, touches))])
    moves = np.array(speed)  # (n,) m/s
    label = by_sliding(moves > SLIDING)
    label[(label == STATIC) & (moves > CREEPS * SLIDING)] = UNKNOWN
    return LabelledRecording(
        zeroed.counts, label, thing.curvature, valid=zeroed.valid, sliding=moves > SLIDING,
        zeroing=WARM_UP + 1, name=name, split=split,
    )  # fmt: skip


def _thing(random: np.random.Generator) -> Object:
    """An object from ranges wider than the six span."""
    curvature = cast("Curvature", random.choice(_CURVATURES, p=_SHARES))
    radius = _between(random, 0.02, 0.09)
    round_ = curvature in ("sphere", "cylinder_y")
    length = 2 * radius if curvature in ("sphere", "cylinder_x") else _between(random, 0.07, 0.3)
    return Object(
        "drawn",
        curvature,
        radius=math.inf if curvature == "plane" else radius,
        width=2 * radius if round_ else _between(random, 0.04, 0.15),
        length=length,
        mass=_between(random, 0.08, 1.0),
        friction=_between(random, 0.4, 1.8),
        texture=float(random.uniform(0.0, 1.35)),
        stiffness=_between(random, 0.2, 1.3),
    )


def _fingertip(random: np.random.Generator) -> Parameters:
    """The fitted one, or one of the wide plan."""
    plain = next(Collection(parameters=Parameters(noise=NOISE)).scenes(int(random.integers(2**31))))
    scene: Scene = varied(plain, random) if random.random() < 0.6 else plain  # noqa: PLR2004 - a share
    return scene.parameters


def _taps(random: np.random.Generator, mass: float, since: float) -> Iterator[Tap]:
    """Blows, from harmless ones to some that move it by centimetres."""
    instant = since
    while random.random() < 0.75 and instant < SECONDS - 0.3:  # noqa: PLR2004 - three on average
        momentum = mass * _between(random, 0.01, 0.5)
        if random.random() < 0.5:  # noqa: PLR2004 - as often
            yield Tap(instant, momentum, "top", _between(random, 0.004, 0.02))
        else:
            yield Tap(
                instant, momentum * float(random.choice([-1, 1])), "side", _between(random, 0.004, 0.02)
            )
        instant += float(random.uniform(0.25, 1.2))


@dataclass
class _Hand:
    """A hand that changes its force at will, and that catches, sooner or later, what slides."""

    random: np.random.Generator
    least: float  # N
    force: float  # N, at first
    rate: float  # N/s
    lag: float  # s, from sliding to its answer
    tail: float  # s, that it goes on after the sliding
    restless: float  # 1/s, changes of force without a reason
    firm: tuple[float, float]  # of the force, steps of an answer
    _since: float = math.nan  # s, from when on it has been sliding
    _until: float = -math.inf  # s, that it answers
    _step: float = 0.0  # s, of the newest step of an answer
    _next: float = 1.4  # s, of the next change

    @classmethod
    def drawn(cls, random: np.random.Generator, least: float) -> "_Hand":
        return cls(
            random,
            least,
            force=least * _between(random, 0.3, 2.2),
            rate=_between(random, 2.0, 60.0),
            lag=_between(random, 0.01, 0.2),
            tail=_between(random, 0.01, 0.3),
            firm=(low := _between(random, 0.01, 0.2), low * _between(random, 1.0, 3.0)),
            restless=_between(random, 0.1, 4.0),
        )

    def turn(self, grasp: Grasp, instant: float, speed: float) -> None:
        """Look at the object, and perhaps press otherwise."""
        random = self.random
        if speed <= SLIDING:
            self._since = math.nan
        elif math.isnan(self._since):
            self._since = instant
        if instant - self._since > self.lag:
            self._until = instant + self.tail
        if instant <= self._until:
            if instant >= self._step:
                self._step = instant + float(random.choice([0.01, 0.01, 0.02, 0.05]))
                more = max(_between(random, *self.firm) * self.force, 0.02 * self.least)
                self.force = min(self.force + more, 12 * self.least)
                grasp.press(self.force, instant, self.rate)
        elif instant > self._next:
            self._next = instant + float(random.exponential(1 / self.restless))
            match random.choice(4):
                case 0:  # a little more
                    self.force *= 1 + _between(random, 0.02, 0.4)
                case 1:  # a little less
                    self.force *= 1 - _between(random, 0.02, 0.3)
                case 2:  # something else
                    self.force = self.least * _between(random, 0.9, 5.0)
                case _:  # slowly down, until it slips
                    self.force *= 0.4
                    grasp.press(self.force, instant, self.force * _between(random, 0.05, 1.0))
                    return
            grasp.press(self.force, instant, self.rate * float(random.choice([1.0, 1.0, 0.2, 4.0])))


def _between(random: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform."""
    return float(low * (high / low) ** random.uniform())
