"""Simulated grasp: one sensorised fingertip and two passive fingers hold an object that a mallet taps.

The hand begins open around an object that stands on a table. The normal force follows the commands at a
limited rate. The equations are in `connectors.sim.body`. The passive fingers are as stiff as the sensorised
one and, unless stated otherwise, of the same rubber; the material of the table is assumed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from connectors.sim import body
from connectors.sim.barometers import Barometers
from connectors.sim.body import GRAVITY, GripModel
from connectors.sim.contact import FingerState
from connectors.sim.finger import contact_model, pad, vibration_velocity
from connectors.sim.objects import Object
from connectors.sim.scene import NO_VIBRATION, Faults, Parameters, Scene, Travel, Vibration
from operators.batch import Reals, Touch, s

RATE: Final = 10.0  # N/s, of a gripper; assumed
FINGER_OFFSET: Final = 0.015  # m, from the middle of the hand to each passive finger; assumed
TABLE_STIFFNESS: Final = 1e4  # N/m per corner; assumed: 0.25 mm under a box of 0.5 kg
TABLE_DAMPING: Final = 0.3  # damping ratio; assumed
KINETIC: Final = 0.9  # friction of the first millimetres of a slide, relative to static friction; assumed
TEXTURE_LIMIT: Final = 0.95  # below 1, so that friction never vanishes


def least_force(held: Object, parameters: Parameters | None = None, *, passive: float | None = None) -> float:
    """Return the minimum normal force (N) that holds an object: m g / (mu_pad + mu_passive).

    Args:
        held: The object.
        parameters: Parameters of the fingertip and the material (default `Parameters()`).
        passive: Friction of the passive fingers for an object whose `friction` is 1 (default: as the pad).

    >>> from connectors.sim.objects import OBJECTS
    >>> round(least_force(OBJECTS["box"]), 2)
    1.96
    """
    pad_friction = (parameters or Parameters()).static_friction
    mu = pad_friction + (pad_friction if passive is None else passive)
    return held.mass * GRAVITY / (held.friction * mu)


def surface(held: Object, parameters: Parameters) -> Scene:
    """Return the surface of an object as a scene, with the parameters of the pad on it."""
    material = replace(
        parameters,
        static_friction=parameters.static_friction * held.friction,
        kinetic_friction=parameters.kinetic_friction * held.friction,
        texture=min(TEXTURE_LIMIT, parameters.texture * held.texture),
        normal_stiffness=parameters.normal_stiffness * held.stiffness,
    )
    return Scene(curvature=held.curvature, radius=held.radius, parameters=material)


def grip_model(
    held: Object, scene: Scene, position: tuple[float, float], passive: float | None = None
) -> GripModel:
    """Return the constants of a grip.

    Args:
        held: The object.
        scene: Its `surface`.
        position: Position of the pad's centre relative to the object's centre (m, m).
        passive: Friction of the passive fingers for an object whose `friction` is 1 (default: as the pad).
    """
    p, contact = scene.parameters, contact_model(scene)
    rubber = p.shear_stiffness * p.width * p.height  # N/m, of all bristles
    return GripModel(
        contact=contact,
        mass=held.mass,
        inertia=held.inertia,
        reach=held.reach,
        half_width=held.width / 2,
        mu=p.static_friction if passive is None else passive * held.friction,
        spring=1 / (1 / p.stiffness + 1 / rubber),  # finger and rubber in series
        damper=contact.damper,
        finger_offset=FINGER_OFFSET,
        foot=held.foot,
        below=held.length / 2,
        table=-position[1] - held.length / 2,
        table_spring=TABLE_STIFFNESS,
        table_damper=TABLE_DAMPING * math.sqrt(2 * TABLE_STIFFNESS * held.mass),
    )


def blow_momentum(grip: GripModel, firm: float, excess: float, slide: float) -> float:
    """Return the momentum (N s) that deflects fingers and rubber until they slip, and then slides the object.

    The passive fingers carry a quarter of the friction each and slip at half the pad's deflection.

    Args:
        grip: The grip.
        firm: Force of the grip, relative to the least that holds.
        excess: Friction left to resist the blow, relative to the weight.
        slide: Length of the slide (m).
    """
    weight = grip.mass * GRAVITY  # N
    deflected = 5 / 16 * (weight * excess) ** 2 / grip.spring  # J, in springs and by sliding passive fingers
    return math.sqrt(2 * grip.mass * (weight * max(KINETIC * firm - 1, 0.0) * slide + deflected))


@dataclass(frozen=True, slots=True)
class Tap:
    """A mallet blow: a half sine of force.

    On top it pushes down through the centre of the object. On the side it pushes along x (or -x for a
    negative momentum), a quarter of the length above the centre, so that it also rotates the object.
    """

    instant: float  # s since the run began
    momentum: float  # N s
    place: Literal["top", "side"] = "top"
    seconds: float = 0.01  # duration; assumed: a soft mallet

    def momentum_until(self, t: Reals) -> Reals:
        """Return the momentum transferred until instants (k,) (s): (k,) N s."""
        u = np.clip((t - self.instant) / self.seconds, 0.0, 1.0)
        return np.asarray(self.momentum * (1 - np.cos(math.pi * u)) / 2)


@dataclass(frozen=True, slots=True)
class GraspState:
    """True state of a grasp at one instant: for tests and summaries, never for a detector."""

    slide_x: float  # m, of the object along the pad since it was gripped, without the rubber's deflection
    slide_y: float  # m; negative when the object slips down
    turned: float  # rad, about the pad's normal, with the rubber's deflection
    speed: float  # m/s, sliding, mean over the pad since the previous sample
    passive_speed: float  # m/s, sliding of the faster passive finger, mean since the previous sample
    height: float  # m, of the object above its initial position
    on_table: bool
    dropped: bool  # the fingers have lost the object permanently
    force: float  # N, normal
    hand: float  # m, height of the hand


class Grasp:
    """A grasp of an object by a hand that is initially open.

    Only the cells are random. The first sample in a process takes seconds, because the physics is compiled.

    Args:
        held: The object.
        parameters: Parameters of the fingertip and the material (default `Parameters()`).
        seed: Random seed of the cells' rest levels and of all noise.
        taps: Mallet blows on the object.
        lift: Lift of the hand; None if the object stays on the table.
        passive: Friction of the passive fingers for an object whose `friction` is 1 (default: as the pad).
        grip: Position of the pad's centre relative to the object's centre (m, m).
        vibration: Vibration of the hand.
    """

    def __init__(
        self,
        held: Object,
        parameters: Parameters | None = None,
        seed: int = 0,
        *,
        taps: Sequence[Tap] = (),
        lift: Travel | None = None,
        passive: float | None = None,
        grip: tuple[float, float] = (0.0, 0.0),
        vibration: Vibration = NO_VIBRATION,
    ) -> None:
        scene = surface(held, parameters or Parameters())
        p = scene.parameters
        self._step = p.step
        self._grip, self._pad = grip_model(held, scene, grip, passive), pad(scene)
        self._tip = FingerState.rest(p.columns * p.rows)
        self._held, self._taps, self._lift, self._vibration = held, tuple(taps), lift, vibration
        sunk = held.mass * body.GRAVITY / (2 * TABLE_STIFFNESS)
        self._body = body.BodyState.standing(-grip[0], -grip[1] - sunk)
        self._body.table[0] = held.mass * body.GRAVITY
        self._start = float(self._body.pose[1])
        self._cells = Barometers(p, Faults(), seed)
        self._ticks = 0
        self._sensed = 0.0  # s, instant of the latest sample
        self._pending: list[tuple[float, float, float]] = []  # start (s), force (N), rate (N/s)
        self._ramp = (0.0, 0.0, 0.0, RATE)  # start (s), initial and final force (N), rate (N/s)

    def press(self, force: float, instant: float, rate: float = RATE) -> None:
        """Command a normal force from an instant on, or from the end of the simulated time if that is later.

        A later command replaces it and starts from the force reached by then.

        Args:
            force: Normal force (N), at least 0.
            instant: Start (s since the run began).
            rate: Rate at which the force changes (N/s).
        """
        self._pending.append((max(instant, self._ticks * self._step), force, rate))
        self._pending.sort(key=lambda ramp: ramp[0])  # stable: at equal instants the later call applies

    def sense(self, instant: float) -> tuple[Touch, GraspState]:
        """Return the sample at an instant (s since the run began), with that timestamp, and the true state.

        Args:
            instant: At least `Parameters.step` after the previous one.
        """
        steps = round(instant / self._step) - self._ticks
        tractions, speed, passive = body.simulate(
            self._grip, self._pad, self._tip, self._body, self._drive(steps)
        )
        self._ticks += steps
        t, aged = np.array([instant]), instant - self._sensed
        self._sensed = instant
        touch = Touch.rows([round(instant * s)], *self._cells.read(t, tractions[None], aged), finger=0)
        return touch, self._state(tractions, (speed, passive))

    def _state(self, tractions: Reals, speeds: tuple[float, float]) -> GraspState:
        """Return the true state, with tractions (3, n) (Pa) and the sliding speeds (m/s)."""
        across, up, turned = self._body.slide.tolist()
        force = float(tractions[0].sum()) * self._grip.contact.area
        if force > 0:  # subtract the mean deflection of the bristles, weighted by pressure
            weight = tractions[0] / (tractions[0].sum() * self._grip.contact.k_t)
            across, up = across - float(tractions[1] @ weight), up - float(tractions[2] @ weight)
        return GraspState(
            across,
            up,
            turned,
            *speeds,
            height=float(self._body.pose[1]) - self._start,
            on_table=bool(self._body.table[0] > 0),
            dropped=bool(self._body.dropped[0]),
            force=force,
            hand=float(self._body.hand[1]),
        )

    def _drive(self, steps: int) -> Reals:
        """Return the next steps (steps, 9) for `body.simulate`."""
        ticks = np.arange(self._ticks, self._ticks + steps + 1, dtype=np.float64)
        edges = ticks * self._step  # (steps + 1,) s
        t = edges[:-1]
        drive = np.zeros((steps, 9))
        if not steps:
            return drive
        drive[:, :2] = vibration_velocity(self._vibration, t)
        if self._lift is not None and edges[-1] > self._lift.start and t[0] < self._lift.end:
            drive[:, 1] += np.diff(self._lift.at(edges)[0]) / self._step
        drive[:, 3] = self._forces(t)
        for tap in self._taps:
            if edges[-1] > tap.instant and t[0] < tap.instant + tap.seconds:
                blow = np.diff(tap.momentum_until(edges)) / self._step  # N, mean over each step
                if tap.place == "top":
                    drive[:, 7] -= blow
                else:
                    drive[:, 6] += blow
                    drive[:, 8] -= blow * self._held.length / 4
        return drive

    def _forces(self, t: Reals) -> Reals:
        """Return the normal force at increasing instants (k,) (s): (k,) N."""
        force = _ramp_force(self._ramp, t)
        while self._pending and self._pending[0][0] <= t[-1]:
            since, last, rate = self._pending.pop(0)
            first = float(_ramp_force(self._ramp, np.array([since]))[0])
            self._ramp = since, first, last, rate
            later = t >= since
            force[later] = _ramp_force(self._ramp, t[later])
        return force


def _ramp_force(ramp: tuple[float, float, float, float], t: Reals) -> Reals:
    """Return the force of a ramp at instants (k,) (s): (k,) N."""
    since, first, last, rate = ramp
    change = rate * (t - since)
    return np.asarray(first + np.clip(last - first, -change, change))
