"""Rigid body between the pad of `connectors.sim.contact` and passive fingers, above a table.

The body moves in the plane of the pad. All vectors are in the initial frame of the hand, x right, y up; the
hand translates without rotation. With velocity U and spin O of the body, c from its centre to the centre of
the pad::

    m dU/dt = -Q + sum f_j + sum (0, n_i) + (0, -m g) + M            M force of the mallet (N)
    I dO/dt = -T - c x Q + sum p_j x f_j + sum r_i x (0, n_i) + L    L moment of the mallet (N m)

Pad: as in `contact`, with the velocity of the tip relative to the body, and the texture along the path
that the pad slid on the body; Q, T friction and its moment on the tip (N, N m). The surface moves with the
body, so that the top of a ball or the crest of a can moves over the pad::

    g = k_x u^2 / 2 + k_y v^2 / 2        (u, v) position of a node relative to the body

Passive fingers: two points at p_j from the centre of the body that carry half of the normal force each, each
a massless spring k and damper c, limited by Coulomb friction::

    ds_j/dt = V - U - O x p_j            V velocity of the hand; without slip
    f_j = k s_j + c ds_j/dt,  |f_j| <= mu F / 2

Table: two corners at r_i, each a unilateral spring and damper, without friction::

    n_i = max(0, k_t h_i + c_t dh_i/dt)  h_i penetration of the corner into the table (m)

A body is dropped, and no finger presses it any longer, once its centre is further from the centre of the
pad than its reach along y or half its width along x. Not modelled: rolling and tilting out of the plane, the
slope of a ball away from its top, air drag.

Steps are semi-implicit Euler, as in `contact`.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from connectors.sim.contact import (
    TINY,
    ContactModel,
    FingerState,
    Pad,
    balance_normal,
    compiled,
    move_tip,
    sum_springs,
    update_friction,
    vectorized,
)
from operators.batch import Reals

GRAVITY: Final = 9.81  # m/s2


class GripModel(NamedTuple):
    """Constants of the equations."""

    contact: ContactModel  # with friction, texture and curvatures of the body
    mass: float  # kg
    inertia: float  # kg m2
    reach: float  # m
    half_width: float  # m
    mu: float  # friction coefficient of the passive fingers
    spring: float  # N/m, of each passive finger
    damper: float  # N s/m
    finger_offset: float  # m, of each passive finger from the centre of the hand along x
    foot: float  # m, of each corner from the centre of the body along x
    below: float  # m, of the corners below the centre of the body
    table: float  # m, height of the table
    table_spring: float  # N/m per corner
    table_damper: float  # N s/m per corner


class BodyState(NamedTuple):
    """State of the body and the passive fingers, changed in place."""

    pose: Reals  # (3,) m, m, rad, of the centre
    velocity: Reals  # (3,) m/s, m/s, rad/s: U and O
    hand: Reals  # (2,) m
    passive: Reals  # (2, 2) m: s_j, by finger, then x and y
    slip_velocity: Reals  # (3,) m/s, m/s, rad/s: of the tip relative to the body, at the pad's centre
    slide: Reals  # (3,) m, m, rad: displacement of the body along the pad while gripped
    path: Reals  # (1,) m: path that the pad slid on the body
    table: Reals  # (1,) N
    dropped: Reals  # (1,) 1 when dropped, else 0

    @classmethod
    def standing(cls, x: float, y: float) -> "BodyState":
        """Return a body at rest with its centre at a position (m)."""
        return cls(
            np.array([x, y, 0.0]), np.zeros(3), np.zeros(2), np.zeros((2, 2)), np.zeros(3),
            np.zeros(3), np.zeros(1), np.zeros(1), np.zeros(1),
        )  # fmt: skip


@vectorized
def place_surface(
    model: ContactModel, pad: Pad, tip: FingerState, body: BodyState, centre: tuple[float, float]
) -> None:
    """Set the gaps of the pad, whose centre is at `centre` (m, m) relative to the body."""
    turned = body.pose[2] + tip.deflection[2]  # the rotation of the tip is -e_o
    cos, sin = math.cos(turned), math.sin(turned)
    for i in range(pad.x.size):
        u = centre[0] + cos * pad.x[i] + sin * pad.y[i]
        v = centre[1] - sin * pad.x[i] + cos * pad.y[i]
        pad.gap[i] = 0.5 * (model.k_x * u * u + model.k_y * v * v)
    if tip.springs[0] != 0.0:
        sum_springs(model, pad, tip)


@compiled
def load_passive_fingers(
    grip: GripModel, body: BodyState, drive: Reals, force: float
) -> tuple[float, float, float, float]:
    """Move the passive fingers by one step; return force and moment on the body (N, N, N m), and sliding.

    The sliding is that of the faster finger, m/s.
    """
    limit, step = 0.5 * grip.mu * force, grip.contact.step
    sum_x, sum_y, moment, sliding = 0.0, 0.0, 0.0, 0.0
    for finger in range(2):
        px = body.hand[0] + (2 * finger - 1) * grip.finger_offset - body.pose[0]
        py = body.hand[1] - body.pose[1]
        ux = drive[0] - body.velocity[0] + body.velocity[2] * py
        uy = drive[1] - body.velocity[1] - body.velocity[2] * px
        sx, sy = body.passive[finger, 0], body.passive[finger, 1]
        fx = grip.spring * (sx + step * ux) + grip.damper * ux
        fy = grip.spring * (sy + step * uy) + grip.damper * uy
        pull = math.sqrt(fx * fx + fy * fy)
        kept = min(limit / (pull + TINY), 1.0)
        fx, fy = fx * kept, fy * kept
        # deflection for which spring and damper give this force at the end of the step
        stiff = grip.spring * step + grip.damper
        sliding = max(sliding, (1.0 - kept) * pull / stiff)
        body.passive[finger, 0] = (fx * step + grip.damper * sx) / stiff
        body.passive[finger, 1] = (fy * step + grip.damper * sy) / stiff
        sum_x, sum_y, moment = sum_x + fx, sum_y + fy, moment + px * fy - py * fx
    return sum_x, sum_y, moment, sliding


@compiled
def support_by_table(grip: GripModel, body: BodyState) -> tuple[float, float]:
    """Return the upward force (N) and the moment (N m) of the table on the body."""
    turned = body.pose[2] if grip.foot > 0.0 else 0.0  # a round body stands on its lowest point
    cos, sin = math.cos(turned), math.sin(turned)
    upward, moment = 0.0, 0.0
    for corner in range(2):
        foot = (2 * corner - 1) * grip.foot
        rx, ry = cos * foot + sin * grip.below, sin * foot - cos * grip.below
        depth = grip.table - body.pose[1] - ry
        if depth > 0.0:
            sinking = -body.velocity[1] - body.velocity[2] * rx
            push = max(0.0, grip.table_spring * depth + grip.table_damper * sinking)
            upward, moment = upward + push, moment + rx * push
    return upward, moment


@compiled
def simulate(
    grip: GripModel, pad: Pad, tip: FingerState, body: BodyState, drive: Reals
) -> tuple[Reals, float, float]:
    """Simulate a grip and sample it at the end.

    Args:
        grip: Constants of the grip.
        pad: Nodes, with gaps that change in place.
        tip: State of the fingertip, changed in place.
        body: State of the body, changed in place.
        drive: (steps, 9) as in `contact.simulate`, without external force and spin, then the mallet
            (N, N, N m).

    Returns:
        Pressure and tractions x and y on the pad (Pa), (3, n), and the mean sliding speeds (m/s) of the pad
        and of the faster passive finger.
    """
    # state for `update_friction`: velocity and path relative to the body
    relative = FingerState(
        tip.deflection, body.slip_velocity, tip.attitude, tip.friction, body.path,
        tip.yaw, tip.pressure, tip.bristle, tip.pressed, tip.springs,
    )  # fmt: skip
    model, pose, velocity, h = grip.contact, body.pose, body.velocity, grip.contact.step
    curved = model.k_x != 0.0 or model.k_y != 0.0
    slid, slid_passive = 0.0, 0.0
    for row in drive:
        cx = body.hand[0] - tip.deflection[0] - pose[0]
        cy = body.hand[1] - tip.deflection[1] - pose[1]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        across, up = cos * cx + sin * cy, cos * cy - sin * cx
        if row[3] > 0.0 and (abs(up) > grip.reach or abs(across) > grip.half_width):
            body.dropped[0] = 1.0
        force = 0.0 if body.dropped[0] != 0.0 else row[3]
        if curved:
            place_surface(model, pad, tip, body, (across, up))
        balance_normal(model, pad, tip, force)
        body.slip_velocity[0] = tip.velocity[0] - velocity[0] + velocity[2] * cy
        body.slip_velocity[1] = tip.velocity[1] - velocity[1] - velocity[2] * cx
        body.slip_velocity[2] = tip.velocity[2] - velocity[2]
        qx, qy, torque, slide = update_friction(model, pad, relative, force)
        slid += slide
        if force > 0.0:
            body.path[0] += h * slide
            for axis in range(3):
                body.slide[axis] -= h * body.slip_velocity[axis]
        fx, fy, twist, sliding = load_passive_fingers(grip, body, row, force)
        if force > 0.0:
            slid_passive += sliding
        upward, tilt = support_by_table(grip, body)
        move_tip(model, tip, row, (qx, qy, torque))
        tip.friction[0], tip.friction[1] = qx, qy
        velocity[0] += h / grip.mass * (fx - qx + row[6])
        velocity[1] += h / grip.mass * (fy - qy + upward + row[7]) - h * GRAVITY
        velocity[2] += h / grip.inertia * (twist - torque - cx * qy + cy * qx + tilt + row[8])
        for axis in range(3):
            pose[axis] += h * velocity[axis]
        body.hand[0] += h * row[0]
        body.hand[1] += h * row[1]
        body.table[0] = upward
    tractions = np.empty((3, pad.x.size))
    for i in range(pad.x.size):
        tractions[0, i] = tip.pressure[i]
        tractions[1, i] = -model.k_t * tip.bristle[0, i]
        tractions[2, i] = -model.k_t * tip.bristle[1, i]
    steps = max(1, drive.shape[0])
    return tractions, slid / steps, slid_passive / steps
