"""One simulated fingertip: touch samples and ground truth from a scene and a seed."""

import math
from dataclasses import replace
from typing import Final, Protocol

import numpy as np

from connectors.sim import contact
from connectors.sim.arm_motion import Controller, PlannedArm
from connectors.sim.barometers import Barometers, grid, randoms
from connectors.sim.scene import Sampler, Scene, Vibration
from operators.batch import Motion, Reals, Touch, Truth, concat, s

_CHUNK: Final = 3000  # samples simulated at once


def contact_model(scene: Scene) -> contact.ContactModel:
    """Return the constants of the contact model of a scene."""
    p = scene.parameters
    return contact.ContactModel(
        step=p.step,
        area=p.width * p.height / (p.columns * p.rows),
        k_n=p.normal_stiffness,
        k_t=p.shear_stiffness,
        mu_s=p.static_friction,
        mu_k=p.kinetic_friction,
        v_s=p.stribeck_speed,
        texture=p.texture,
        wave_1=2 * math.pi / p.texture_lengths[0],
        wave_2=2 * math.pi / p.texture_lengths[1],
        mass=p.mass,
        spring=p.stiffness,
        damper=2 * p.damping * math.sqrt(p.stiffness * p.mass),
        inertia=p.inertia,
        twist_spring=p.twist_stiffness,
        twist_damper=2 * p.damping * math.sqrt(p.twist_stiffness * p.inertia),
        tilt_spring=p.tilt_stiffness,
        lever=p.lever,
        tilt_x=scene.tilt[0],
        tilt_y=scene.tilt[1],
        k_x=scene.curvatures[0],
        k_y=scene.curvatures[1],
        apex_x=scene.apex[0],
        apex_y=scene.apex[1],
        pivot_x=scene.offset[0],
        pivot_y=scene.offset[1],
    )


def pad(scene: Scene) -> contact.Pad:
    """Return the nodes of the pad over the surface of a scene."""
    p = scene.parameters
    x, y = grid(p)
    kx, ky = scene.curvatures
    gap = (kx * (x - scene.apex[0]) ** 2 + ky * (y - scene.apex[1]) ** 2) / 2
    return contact.Pad(x, y, gap)


def vibration_velocity(vibration: Vibration, t: Reals) -> Reals:
    """Return the velocity of a vibration at instants (k,) (s): (k, 2) m/s."""
    pulse, heading = 2 * math.pi * vibration.frequency, math.radians(vibration.direction_deg)
    speed = pulse * vibration.amplitude * np.cos(pulse * t)
    return np.multiply.outer(speed, (math.cos(heading), math.sin(heading)))


class Arm(Protocol):
    """An arm that carries a fingertip."""

    def at(self, times: Reals) -> tuple[Reals, Reals]:
        """Return drive (k, 6) and pose (k, 3) at increasing instants (k,) (s); see `PlannedArm.at`."""
        ...


class Finger:
    """A fingertip in a scene.

    Args:
        scene: The scene.
        seed: Random seed of the plan and, with `finger`, of the cells' rest levels and of all noise.
        finger: Number of the fingertip (default 0).
        arm: Arm that moves the fingertip (default: one that executes the plan).
    """

    def __init__(self, scene: Scene, seed: int, finger: int = 0, arm: Arm | None = None) -> None:
        p = self._p = scene.parameters
        self._scene, self._finger, self._arm = scene, finger, arm or PlannedArm(scene, seed)
        self._model, self._pad = contact_model(scene), pad(scene)
        self._state = contact.FingerState.rest(p.columns * p.rows)
        self._ticks = 0  # simulated physics steps
        self._path = 0.0  # m, of the arm at the pad until then
        self._sensed = 0.0  # s, instant of the latest sample of `sense`
        self._cells = Barometers(p, scene.faults, seed, finger)
        self._sampler = Sampler(scene.touch, randoms(seed, finger)[1])

    def take(self, samples: int) -> tuple[Touch, Truth] | None:
        """Return the next samples, timestamped from the run's start, and the truth of each.

        There are fewer if the plan ends or samples are lost; None after the plan's end.
        """
        t = self._sampler.instants(samples)  # (k,) s
        touch, truth = self._read(t, 1 / self._scene.touch.rate)
        if not len(touch):
            return None
        time, arrive = self._sampler.stamp(len(touch))
        touch = replace(touch, time=time)
        return (touch, truth) if arrive.all() else (touch[arrive], truth[arrive])

    def sense(self, instant: float) -> tuple[Touch, Truth]:
        """Return the sample at an instant (s since the run began), with that timestamp, and its truth.

        Both are empty after the end of the plan. Use it for a fingertip that a host reads on its own
        schedule, never together with `take`.

        Args:
            instant: At least `Parameters.step` after the previous one.
        """
        aged = instant - self._sensed
        self._sensed = instant
        return self._read(np.array([instant]), aged)

    def _read(self, t: Reals, aged: float) -> tuple[Touch, Truth]:
        """Return samples, timestamped at their instants (k,) (s), and their truth.

        Args:
            t: Instants; those after the end of the plan are omitted.
            aged: Time between instants (s).
        """
        until = np.rint(t / self._p.step).astype(np.int64) - self._ticks
        drive = self._drive(int(until[-1]))
        t, until = t[until <= len(drive)], until[until <= len(drive)]
        if not len(t):
            return Touch.empty(), Truth.empty()
        tractions, contact_truth = contact.simulate(self._model, self._pad, self._state, drive, until)
        self._ticks += int(until[-1])
        velocity = np.zeros((len(t), 3))
        moved = until > 0
        velocity[moved] = drive[until[moved] - 1, :3]
        time = np.rint(t * s).astype(np.int64)
        touch = Touch.rows(time, *self._cells.read(t, tractions, aged), finger=self._finger)
        return touch, Truth(time, contact_truth[:, 0], contact_truth[:, 1], velocity, finger=self._finger)

    def _drive(self, steps: int) -> Reals:
        """Return the next steps (steps, 6) of the arm for `contact.simulate`; fewer when the plan ends."""
        t = np.arange(self._ticks, self._ticks + steps, dtype=np.float64) * self._p.step
        drive, _ = self._arm.at(t)
        x, y = self._scene.offset
        if x or y:
            drive[:, 0] -= drive[:, 2] * y
            drive[:, 1] += drive[:, 2] * x
        if self._p.unevenness:
            drive[:, 3] *= self._uneven(drive)
        drive[:, :2] += vibration_velocity(self._scene.vibration, t[: len(drive)])
        return drive

    def _uneven(self, drive: Reals) -> Reals:
        """Return the factor of the normal force at the next steps (steps,): a stiff arm follows no bumps."""
        steps = np.hypot(drive[:, 0], drive[:, 1]) * self._p.step
        path = np.cumsum(np.append(self._path, steps))  # added in order, however it is cut
        self._path = float(path[-1])
        first, second = (np.sin(2 * math.pi * path[1:] / length) for length in self._p.uneven_lengths)
        return np.asarray(1 + self._p.unevenness / 2 * (first - second))


def simulate_scene(scene: Scene, seed: int) -> tuple[Touch, Motion, Truth]:
    """Simulate one fingertip and the arm to the end of the plan; times are relative to the run's start."""
    finger, controller = Finger(scene, seed), Controller(scene, seed)
    taken = list(iter(lambda: finger.take(_CHUNK), None))
    motion = concat(Motion, list(iter(lambda: controller.take(_CHUNK), None)))
    return concat(Touch, [touch for touch, _ in taken]), motion, concat(Truth, [truth for _, truth in taken])


def compile_physics() -> None:
    """Compile the physics, or load it from the cache; call it before a live run starts."""
    Finger(Scene(), 0).take(2)
