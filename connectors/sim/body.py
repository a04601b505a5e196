"""A rigid body in a grip: between the pad of `connectors.sim.contact` and passive fingers, over a table.

It moves in the pad's plane. All vectors are in the hand's frame as it stood at first, x right, y up; the hand
moves and does not turn. With velocity U and spin O of the body, c from its middle to the pad's middle::

    m dU/dt = -Q + sum f_j + sum (0, n_i) + (0, -m g) + M            M mallet (N)
    I dO/dt = -T - c x Q + sum p_j x f_j + sum r_i x (0, n_i) + L    L moment of the mallet (N m)

Pad: its equations are `contact`'s, in which its nodes see the velocity of the tip along the body, and the
texture the path along the body; Q, T friction and its moment on the tip (N, N m). The surface goes with the
body, so that the top of a ball or the crest of a can wanders over the pad::

    g = k_x u^2 / 2 + k_y v^2 / 2        (u, v) place of a node as seen from the body

Passive fingers: two points at p_j from the body's middle that press back with half of the normal force each,
every one a spring k and a damper c (massless) that ends in Coulomb friction::

    ds_j/dt = V - U - O x p_j            V velocity of the hand, less what slips
    f_j = k s_j + c ds_j/dt,  |f_j| <= mu F / 2

Table: two corners at r_i, each a spring and a damper that only push, without friction::

    n_i = max(0, k_t h_i + c_t dh_i/dt)  h_i depth of the corner under the table's top (m)

A body whose middle is further than its reach above or below the pad's middle, or further than half its width
beside it, is dropped: no finger presses any more. Left out: rolling and tilting out of the plane, the slope
of a ball off its top, drag of the air.

Steps are semi-implicit Euler, those of `contact`. `body_numpy.simulate` says the same in array arithmetic.
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
    """The scalars of the equations."""

    contact: ContactModel  # its frictions, texture and curvatures are the body's
    mass: float  # kg
    inertia: float  # kg m2
    reach: float  # m
    half_width: float  # m
    mu: float  # of the passive fingers
    spring: float  # N/m, of each of them
    damper: float  # N s/m
    finger_offset: float  # m, each from the middle of the hand along x
    foot: float  # m, each corner from the middle along x
    below: float  # m, the corners under the middle
    table: float  # m, height of the table
    table_spring: float  # N/m, of each corner
    table_damper: float  # N s/m


class BodyState(NamedTuple):
    """What changes, in place."""

    place: Reals  # (3,) m, m, rad, of its middle
    velocity: Reals  # (3,) m/s, m/s, rad/s: U and O
    hand: Reals  # (2,) m
    passive: Reals  # (2, 2) m: s_j, by finger, then x and y
    slip_velocity: Reals  # (3,) m/s, m/s, rad/s: velocity of the tip along the body, at the pad's middle
    slide: Reals  # (3,) m, m, rad: way of the body along the pad while it is gripped
    path: Reals  # (1,) m: length of the tip's way along the body
    table: Reals  # (1,) N
    dropped: Reals  # (1,) 1 once it is, else 0

    @classmethod
    def standing(cls, x: float, y: float) -> "BodyState":
        """A body at rest with its middle at a place (m)."""
        return cls(
            np.array([x, y, 0.0]), np.zeros(3), np.zeros(2), np.zeros((2, 2)), np.zeros(3),
            np.zeros(3), np.zeros(1), np.zeros(1), np.zeros(1),
        )  # fmt: skip


@vectorized
def place_surface(
    model: ContactModel, pad: Pad, tip: FingerState, body: BodyState, seen: tuple[float, float]
) -> None:
    """Put the body's surface under the pad, whose middle is `seen` from the body at a place (m, m)."""
    turned = body.place[2] + tip.deflection[2]  # the tip has turned by -e_o
    cos, sin = math.cos(turned), math.sin(turned)
    for i in range(pad.x.size):
        u = seen[0] + cos * pad.x[i] + sin * pad.y[i]
        v = seen[1] - sin * pad.x[i] + cos * pad.y[i]
        pad.gap[i] = 0.5 * (model.k_x * u * u + model.k_y * v * v)
    if tip.springs[0] != 0.0:
        sum_springs(model, pad, tip)


@compiled
def load_passive_fingers(
    grip: GripModel, body: BodyState, drive: Reals, force: float
) -> tuple[float, float, float]:
    """Move the springs of the passive fingers by one step; their force and moment on the body (N, N, N m)."""
    limit, step = 0.5 * grip.mu * force, grip.contact.step
    sum_x, sum_y, moment = 0.0, 0.0, 0.0
    for finger in range(2):
        px = body.hand[0] + (2 * finger - 1) * grip.finger_offset - body.place[0]
        py = body.hand[1] - body.place[1]
        ux = drive[0] - body.velocity[0] + body.velocity[2] * py
        uy = drive[1] - body.velocity[1] - body.velocity[2] * px
        sx, sy = body.passive[finger, 0], body.passive[finger, 1]
        fx = grip.spring * (sx + step * ux) + grip.damper * ux
        fy = grip.spring * (sy + step * uy) + grip.damper * uy
        kept = min(limit / (math.sqrt(fx * fx + fy * fy) + TINY), 1.0)
        fx, fy = fx * kept, fy * kept
        # the deflection, and its rate over this step, at which spring and damper give that force
        stiff = grip.spring * step + grip.damper
        body.passive[finger, 0] = (fx * step + grip.damper * sx) / stiff
        body.passive[finger, 1] = (fy * step + grip.damper * sy) / stiff
        sum_x, sum_y, moment = sum_x + fx, sum_y + fy, moment + px * fy - py * fx
    return sum_x, sum_y, moment


@compiled
def support_by_table(grip: GripModel, body: BodyState) -> tuple[float, float]:
    """Force (N, upward) and moment (N m) of the table on the body."""
    turned = body.place[2] if grip.foot > 0.0 else 0.0  # what is round stands on its lowest point
    cos, sin = math.cos(turned), math.sin(turned)
    upward, moment = 0.0, 0.0
    for corner in range(2):
        foot = (2 * corner - 1) * grip.foot
        rx, ry = cos * foot + sin * grip.below, sin * foot - cos * grip.below
        depth = grip.table - body.place[1] - ry
        if depth > 0.0:
            sinking = -body.velocity[1] - body.velocity[2] * rx
            push = max(0.0, grip.table_spring * depth + grip.table_damper * sinking)
            upward, moment = upward + push, moment + rx * push
    return upward, moment


@compiled
def simulate(
    grip: GripModel, pad: Pad, tip: FingerState, body: BodyState, drive: Reals
) -> tuple[Reals, float]:
    """Run a grip and read it at the end.

    Args:
        grip: The constants.
        pad: The nodes; their gaps change in place.
        tip: Where the fingertip stands; changed in place.
        body: Where the body stands; changed in place.
        drive: (steps, 9) as in `contact.simulate`, without push and spin, then the mallet (N, N, N m).

    Returns:
        Pressure and tractions x and y on the pad (Pa), (3, n), and the mean sliding speed (m/s).
    """
    # the pad as `update_friction` sees it: moving along the body
    skin = FingerState(
        tip.deflection, body.slip_velocity, tip.attitude, tip.friction, body.path,
        tip.yaw, tip.pressure, tip.bristle, tip.pressed, tip.springs,
    )  # fmt: skip
    model, place, velocity, h = grip.contact, body.place, body.velocity, grip.contact.step
    curved = model.k_x != 0.0 or model.k_y != 0.0
    slid = 0.0
    for row in drive:
        cx = body.hand[0] - tip.deflection[0] - place[0]
        cy = body.hand[1] - tip.deflection[1] - place[1]
        cos, sin = math.cos(place[2]), math.sin(place[2])
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
        qx, qy, torque, slide = update_friction(model, pad, skin, force)
        slid += slide
        if force > 0.0:
            body.path[0] += h * math.sqrt(
                body.slip_velocity[0] * body.slip_velocity[0] + body.slip_velocity[1] * body.slip_velocity[1]
            )
            for axis in range(3):
                body.slide[axis] -= h * body.slip_velocity[axis]
        fx, fy, twist = load_passive_fingers(grip, body, row, force)
        upward, tilt = support_by_table(grip, body)
        move_tip(model, tip, row, (qx, qy, torque))
        tip.friction[0], tip.friction[1] = qx, qy
        velocity[0] += h / grip.mass * (fx - qx + row[6])
        velocity[1] += h / grip.mass * (fy - qy + upward + row[7]) - h * GRAVITY
        velocity[2] += h / grip.inertia * (twist - torque - cx * qy + cy * qx + tilt + row[8])
        for axis in range(3):
            place[axis] += h * velocity[axis]
        body.hand[0] += h * row[0]
        body.hand[1] += h * row[1]
        body.table[0] = upward
    tractions = np.empty((3, pad.x.size))
    for i in range(pad.x.size):
        tractions[0, i] = tip.pressure[i]
        tractions[1, i] = -model.k_t * tip.bristle[0, i]
        tractions[2, i] = -model.k_t * tip.bristle[1, i]
    return tractions, slid / max(1, drive.shape[0])
