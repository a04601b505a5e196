"""The equations of `connectors.sim.body` in plain array arithmetic: slow, short, its judge.

The two agree to rounding until the pad first slips; stick-slip is chaotic after that.
"""

import numpy as np

from connectors.sim.body import GRAVITY, BodyState, GripModel
from connectors.sim.contact import ContactModel, FingerState, Pad
from operators.batch import Reals
from tests.connectors.sim import contact_numpy


def rotation(angle: float) -> Reals:
    """The matrix (2, 2) that turns anticlockwise."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def moment(arm: Reals, force: Reals) -> float:
    """Return the moment of a force at the end of an arm (N m)."""
    return float(arm[0] * force[1] - arm[1] * force[0])


def at(body: BodyState, arm: Reals) -> Reals:
    """Velocity (2,) (m/s) of the body's point at an arm (m) from its middle."""
    velocity: Reals = body.velocity[:2] + body.velocity[2] * np.array([-arm[1], arm[0]])
    return velocity


def place_surface(model: ContactModel, pad: Pad, tip: FingerState, body: BodyState, seen: Reals) -> None:
    """Put the body's surface under the pad, whose middle is at `seen` (2,) (m) from the body."""
    nodes = seen[:, None] + rotation(-body.pose[2] - tip.deflection[2]) @ np.stack([pad.x, pad.y])  # (2, n)
    pad.gap[:] = np.array([model.k_x, model.k_y]) / 2 @ nodes**2


def load_passive_fingers(grip: GripModel, body: BodyState, hand: Reals, force: float) -> tuple[Reals, float]:
    """Move the springs of the passive fingers by one step; their force and moment (3,), and sliding speed."""
    total, step, sliding = np.zeros(3), grip.contact.step, 0.0
    for finger, side in enumerate((-1.0, 1.0)):
        arm = body.hand + np.array([side * grip.finger_offset, 0.0]) - body.pose[:2]
        velocity = hand - at(body, arm)
        before = body.passive[finger].copy()
        pull = grip.spring * (before + step * velocity) + grip.damper * velocity
        limit = grip.mu * force / 2
        if np.hypot(*pull) > limit:
            pull *= limit / np.hypot(*pull)
        body.passive[finger] = (pull + grip.damper / step * before) / (grip.spring + grip.damper / step)
        stretched = (body.passive[finger] - before) / step
        sliding = max(sliding, float(np.hypot(*(velocity - stretched))))
        total += [*pull, moment(arm, pull)]
    return total, sliding if force else 0.0


def support_by_table(grip: GripModel, body: BodyState) -> Reals:
    """Force and moment (3,) of the table on the body."""
    total = np.zeros(3)
    for side in (-1.0, 1.0):
        turned = body.pose[2] if grip.foot else 0.0
        arm = rotation(turned) @ np.array([side * grip.foot, -grip.below])
        depth = grip.table - (body.pose[1] + arm[1])
        if depth > 0.0:
            push = grip.table_spring * depth - grip.table_damper * at(body, arm)[1]
            upward = np.array([0.0, max(0.0, push)])
            total += [*upward, moment(arm, upward)]
    return total


def simulate(
    grip: GripModel, pad: Pad, tip: FingerState, body: BodyState, drive: Reals
) -> tuple[Reals, float, float]:
    """Run a grip and read it at the end, as `body.simulate` does."""
    model, slid, slid_passive = grip.contact, list[float](), list[float]()
    skin = tip._replace(velocity=body.slip_velocity, path=body.path)
    inertia = np.array([grip.mass, grip.mass, grip.inertia])
    for row in drive:
        c = body.hand - tip.deflection[:2] - body.pose[:2]
        seen = rotation(-body.pose[2]) @ c
        off = abs(seen[1]) > grip.reach or abs(seen[0]) > grip.half_width
        if row[3] > 0.0 and off:
            body.dropped[0] = 1.0
        force = 0.0 if body.dropped[0] else float(row[3])
        place_surface(model, pad, tip, body, seen)
        contact_numpy.balance_normal(model, pad, tip, force)
        body.slip_velocity[:2] = tip.velocity[:2] - at(body, c)
        body.slip_velocity[2] = tip.velocity[2] - body.velocity[2]
        friction, slide = contact_numpy.update_friction(model, pad, skin)
        slid.append(slide)
        if force > 0.0:
            body.path[0] += model.step * slide
            body.slide[:] -= model.step * body.slip_velocity
        table = support_by_table(grip, body)
        pull, sliding = load_passive_fingers(grip, body, row[:2], force)
        slid_passive.append(sliding)
        forces = pull + table + row[6:]
        forces -= [*friction[:2], friction[2] + moment(c, friction[:2])]
        forces[1] -= grip.mass * GRAVITY
        contact_numpy.move_tip(model, tip, row, friction)
        tip.friction[:] = friction[:2]
        body.velocity[:] += model.step * forces / inertia
        body.pose[:] += model.step * body.velocity
        body.hand[:] += model.step * row[:2]
        body.table[0] = table[1]
    tractions = np.stack([tip.pressure, *(-model.k_t * tip.bristle)])
    return tractions, float(np.mean(slid)), float(np.mean(slid_passive))
