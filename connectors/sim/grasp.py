"""A grasp: one sensorised fingertip and passive fingers hold an object, lift it, and are tapped.

The hand begins with open fingers around an object that stands on a table. At `closing` it presses; from then
on the normal force follows what is commanded, at a limited rate. `connectors.sim.body` has the equations.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from connectors.sim import body
from connectors.sim.barometers import Barometers
from connectors.sim.body import GRAVITY, GripModel
from connectors.sim.contact import FingerState
from connectors.sim.finger import contact_model, pad, vibration_velocity
from connectors.sim.grasp_actions import Lift, Tap
from connectors.sim.objects import Object
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import NOISE, Faults, Scene, Vibration
from operators.batch import Reals, Touch, s
from operators.errors import ParameterError

PASSIVE_FRICTION: Final = 0.6  # of the passive fingers on the scene's material; assumed: hard plastic pads
FINGER_OFFSET: Final = 0.015  # m, the passive fingers from the middle; assumed: a pinch
TABLE_STIFFNESS: Final = 1e4  # N/m of each corner; assumed: 0.25 mm under a box of 0.5 kg
TABLE_DAMPING: Final = 0.3  # of critical; assumed
DEEPEST: Final = 0.95  # of the texture: friction never vanishes


def least_force(
    held: Object,
    parameters: Parameters | None = None,
    *,
    friction: float = 1.0,
    mass: float = 1.0,
    passive: float = PASSIVE_FRICTION,
    acceleration: float = 0.0,
    texture: float = 1.0,
) -> float:
    """The least grip force (N) that holds an object: m (g + a) / (mu_pad + mu_passive).

    Args:
        held: What is held.
        parameters: Of the fingertip and the scene's material.
        friction: Factor of all frictions.
        mass: Factor of the mass.
        passive: Friction of the passive fingers, of an object whose `friction` is 1.
        acceleration: Of the hand, upwards (m/s2).
        texture: Factor of the pad's friction at this place of the object: 1 where it is first gripped. Along
            the way it lies within 1 - c and 1 + c, c the `texture` of `material`.

    >>> from connectors.sim.objects import named
    >>> round(least_force(named("box")), 2)
    1.87
    """
    mu = (parameters or Parameters()).static_friction * texture + passive
    return held.mass * mass * (GRAVITY + acceleration) / (held.friction * friction * mu)


def material(held: Object, parameters: Parameters) -> Parameters:
    """What the pad touches when it touches an object."""
    return replace(
        parameters,
        static_friction=parameters.static_friction * held.friction,
        kinetic_friction=parameters.kinetic_friction * held.friction,
        texture=min(DEEPEST, parameters.texture * held.texture),
        normal_stiffness=parameters.normal_stiffness * held.stiffness,
    )


def surface(held: Object, parameters: Parameters) -> Scene:
    """What the pad is pressed on."""
    return Scene(curvature=held.curvature, radius=held.radius, parameters=material(held, parameters))


def grip_model(held: Object, scene: Scene, place: tuple[float, float], passive: float) -> GripModel:
    """The constants of a grip.

    Args:
        held: What is held.
        scene: Its `surface`.
        place: Of the pad's middle as seen from the object's middle (m, m).
        passive: Friction of the passive fingers, of an object whose `friction` is 1.
    """
    p, contact = scene.parameters, contact_model(scene)
    rubber = p.shear_stiffness * p.width * p.height  # N/m, of all bristles
    return GripModel(
        contact=contact,
        mass=held.mass,
        inertia=held.inertia,
        reach=held.reach,
        half_width=held.width / 2,
        mu=passive * held.friction,
        spring=1 / (1 / p.stiffness + 1 / rubber),  # finger and rubber in series
        damper=contact.damper,
        finger_offset=FINGER_OFFSET,
        foot=held.foot,
        below=held.length / 2,
        table=-place[1] - held.length / 2,
        table_spring=TABLE_STIFFNESS,
        table_damper=TABLE_DAMPING * math.sqrt(2 * TABLE_STIFFNESS * held.mass),
    )


@dataclass(frozen=True, slots=True)
class Held:
    """What really happens in a grasp at one instant: for tests and summaries, never for a detector."""

    instant: float  # s since the run began
    slide_x: float  # m, of the object along the pad since it was gripped, less what the rubber gives
    slide_y: float  # m; falling is negative
    turned: float  # rad, about the pad's normal, with what the rubber gives
    speed: float  # m/s, of sliding, mean over the pad since the newest instant before
    height: float  # m, of the object above where it began
    on_table: bool
    dropped: bool  # the fingers have lost it, for good
    force: float  # N, normal
    hand: float  # m, height of the hand


class Grasp:
    """An object in a hand, from open fingers on.

    The passive fingers are as stiff as the sensorised one. Nothing is random but the cells. The first sample
    in a process takes seconds, while the physics is compiled.

    Args:
        held: What is grasped.
        parameters: Of the fingertip and the scene's material; the default has the noise of real cells.
        seed: Of the cells' rest levels and of all noise.
        force: Normal force that the hand closes with (N).
        closing: When it closes (s since the run began): a baseline can be taken before.
        rate: At which the force changes unless `press` says otherwise (N/s).
        taps: Blows on the object.
        lift: The hand's way up; None: the object stays on the table.
        friction: Factor of all frictions.
        mass: Factor of the object's mass and moment of inertia.
        passive: Friction of the passive fingers, of an object whose `friction` is 1.
        grip: Place of the pad's middle as seen from the object's middle (m, m).
        vibration: A shaking of the hand.
        faults: What is wrong with the barometers.
        finger: Which fingertip it is.

    Raises:
        ParameterError: if a value is out of its range.
    """

    def __init__(
        self,
        held: Object,
        parameters: Parameters | None = None,
        seed: int = 0,
        *,
        force: float,
        closing: float = 1.0,
        rate: float = 10.0,
        taps: Sequence[Tap] = (),
        lift: Lift | None = None,
        friction: float = 1.0,
        mass: float = 1.0,
        passive: float = PASSIVE_FRICTION,
        grip: tuple[float, float] = (0.0, 0.0),
        vibration: Vibration | None = None,
        faults: Faults | None = None,
        finger: int = 0,
    ) -> None:
        for name, value in (("friction", friction), ("mass", mass), ("rate", rate)):
            if not value > 0:
                raise ParameterError("Grasp", name, value, "above 0")
        if not passive >= 0:
            raise ParameterError("Grasp", "passive", passive, "at least 0")
        if abs(grip[1]) >= held.reach or abs(grip[0]) >= held.width / 2:
            must_be = f"on the {held.name}: less than {held.width / 2:g} and {held.reach:g} m off its middle"
            raise ParameterError("Grasp", "grip", grip, must_be)
        held = replace(held, friction=held.friction * friction, mass=held.mass * mass)
        scene = surface(held, parameters or Parameters(noise=NOISE))
        p = scene.parameters
        self._step, self._finger, self._rate = p.step, finger, rate
        self._grip, self._pad = grip_model(held, scene, grip, passive), pad(scene)
        self._tip = FingerState.rest(p.columns * p.rows)
        self._held, self._taps, self._lift, self._vibration = held, tuple(taps), lift, vibration
        sunk = held.mass * body.GRAVITY / (2 * TABLE_STIFFNESS)
        self._body = body.BodyState.standing(-grip[0], -grip[1] - sunk)
        self._body.table[0] = held.mass * body.GRAVITY
        self._start = float(self._body.place[1])
        randoms = np.random.default_rng([seed, 2, finger]).spawn(4)  # as of a `Finger`
        self._cells = Barometers(p, faults or Faults(), randoms[0], randoms[2], randoms[3])
        self._creep_time = p.creep_time
        self._ticks = 0
        self._sensed = 0.0  # s, of the newest sample
        self._aims: list[tuple[float, float, float]] = []  # s, N, N/s: from when, to what, how fast
        self._aim = (0.0, 0.0, 0.0, rate)  # s, N, N, N/s: since when, from, to, how fast
        self.press(force, closing)

    def press(self, force: float, instant: float, rate: float | None = None) -> None:
        """Command a normal force (N) from an instant on (s); what is simulated already stays as it is.

        A later command replaces it, from the force that is reached by then.

        Args:
            force: At least 0.
            instant: Since the run began.
            rate: At which the force changes (N/s); None: the grasp's.

        Raises:
            ParameterError: if the force or the rate is out of its range.
        """
        fast = self._rate if rate is None else rate
        if not 0 <= force < math.inf:
            raise ParameterError("Grasp.press", "force", force, "a number of newtons, at least 0")
        if not fast > 0:
            raise ParameterError("Grasp.press", "rate", fast, "above 0")
        self._aims.append((max(instant, self._ticks * self._step), force, fast))
        self._aims.sort(key=lambda aim: aim[0])  # stable: of two at one instant, the later call counts

    def sense(self, instant: float) -> tuple[Touch, Held]:
        """One sample at an instant of one's own choice (s since the run began), stamped with it.

        Args:
            instant: Later than the one before, by `Parameters.step` at least.

        Raises:
            ParameterError: if it is before the newest one.
        """
        steps = round(instant / self._step) - self._ticks
        if steps < 0:
            raise ParameterError("Grasp.sense", "instant", instant, f"not before {self._sensed} s")
        tractions, speed = body.simulate(self._grip, self._pad, self._tip, self._body, self._drive(steps))
        self._ticks += steps
        t, aged = np.array([instant]), (instant - self._sensed) / self._creep_time
        self._sensed = instant
        counts, temperature, valid = self._cells.read(t, tractions[None], aged)
        touch = Touch(np.array([round(instant * s)]), counts, temperature, valid, finger=self._finger)
        return touch, self._happened(instant, speed, tractions)

    def _happened(self, instant: float, speed: float, tractions: Reals) -> Held:
        """The truth, from tractions (3, n) (Pa) and what else the scene knows."""
        across, up, turned = self._body.slide.tolist()
        force = float(tractions[0].sum()) * self._grip.contact.area
        if force > 0:  # bristles that bend with the load, each as heavy as its pressure
            share = tractions[0] / (tractions[0].sum() * self._grip.contact.k_t)
            across, up = across - float(tractions[1] @ share), up - float(tractions[2] @ share)
        return Held(
            instant,
            across,
            up,
            turned,
            speed,
            height=float(self._body.place[1]) - self._start,
            on_table=bool(self._body.table[0] > 0),
            dropped=bool(self._body.dropped[0]),
            force=force,
            hand=float(self._body.hand[1]),
        )

    def _drive(self, steps: int) -> Reals:
        """The next steps (steps, 9) for `body.simulate`."""
        ticks = np.arange(self._ticks, self._ticks + steps + 1, dtype=np.float64)
        edges = ticks * self._step  # (steps + 1,) s
        t = edges[:-1]
        drive = np.zeros((steps, 9))
        if not steps:
            return drive
        if self._vibration is not None:
            drive[:, :2] = vibration_velocity(self._vibration, t)
        if self._lift is not None and edges[-1] > self._lift.instant and t[0] < self._lift.end:
            drive[:, 1] += np.diff(self._lift.climbed(edges)) / self._step
        drive[:, 3] = self._forces(t)
        for tap in self._taps:
            if edges[-1] > tap.instant and t[0] < tap.instant + tap.seconds:
                blow = np.diff(tap.given(edges)) / self._step  # N, mean over each step
                if tap.place == "top":
                    drive[:, 7] -= blow
                else:
                    drive[:, 6] += blow
                    drive[:, 8] -= blow * self._held.length / 4
        return drive

    def _forces(self, t: Reals) -> Reals:
        """The normal force at instants (k,) (s) that never go back: (k,) N."""
        force = _ramp(self._aim, t)
        while self._aims and self._aims[0][0] <= t[-1]:
            since, last, rate = self._aims.pop(0)
            first = float(_ramp(self._aim, np.array([since]))[0])
            self._aim = since, first, last, rate
            later = t >= since
            force[later] = _ramp(self._aim, t[later])
        return force


def _ramp(aim: tuple[float, float, float, float], t: Reals) -> Reals:
    """A force that has changed since an instant, at a limited rate: (k,) N at instants (k,) (s)."""
    since, first, last, rate = aim
    change = rate * (t - since)
    return np.asarray(first + np.clip(last - first, -change, change))
