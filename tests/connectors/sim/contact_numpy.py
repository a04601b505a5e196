"""The equations of `connectors.sim.contact` in plain array arithmetic: slow, short, its judge.

Stick-slip is chaotic, so the two agree to rounding until the first node slips, and in statistics after that.
"""

import numpy as np

from connectors.sim.contact import Law, Pad, State
from operators.batch import Reals, Times


def turn(law: Law, pad: Pad, state: State, spin: float) -> None:
    """Turn the surface under the pad by one step."""
    state.yaw[0] += spin * law.step
    cos, sin = np.cos(state.yaw[0]), np.sin(state.yaw[0])
    pivot = np.array([[law.pivot_x], [law.pivot_y]])
    place = np.array([[cos, -sin], [sin, cos]]) @ (np.stack([pad.x, pad.y]) + pivot) - pivot  # (2, n)
    place -= [[law.apex_x], [law.apex_y]]
    pad.gap[:] = np.array([law.k_x, law.k_y]) / 2 @ place**2


def press(law: Law, pad: Pad, state: State, force: float) -> None:
    """Balance the normal force and the tilting moments."""
    if force <= 0.0:
        state.pressed[:] = 0.0
        state.pressure[:] = 0.0
        return
    shape = np.stack([np.ones_like(pad.x), pad.x, pad.y])  # (3, n) overlap = attitude @ shape - gap
    springs = np.diag([0.0, law.tilt_spring, law.tilt_spring])
    rest = law.tilt_spring * np.array([0.0, law.tilt_x, law.tilt_y])
    rest[1:] -= law.lever * state.friction
    rest[0] = force
    if not state.pressed.any():
        state.pressed[:] = 1.0
    for _ in range(12):
        weight = law.k_n * law.area * state.pressed  # (n,)
        state.attitude[:] = np.linalg.solve(
            shape * weight @ shape.T + springs, rest + shape @ (weight * pad.gap)
        )
        overlap = state.attitude @ shape - pad.gap  # (n,)
        before = state.pressed.copy()
        state.pressed[:] = np.where(overlap > 0.0, 1.0, 0.0)
        state.pressure[:] = law.k_n * np.maximum(overlap, 0.0)
        if (before == state.pressed).all():
            break


def rub(law: Law, pad: Pad, state: State) -> tuple[Reals, float]:
    """Move the bristles by one step; the friction (3,) (N, N, N m) on the tip and its sliding speed (m/s)."""
    place = np.stack([-pad.y, pad.x], axis=1)  # (n, 2) velocity of a node per spin
    velocity = state.velocity[:2] + state.velocity[2] * place  # (n, 2)
    waves = np.sin(state.path[0] * np.array([law.wave_1, law.wave_2]))
    texture = 1.0 + 0.5 * law.texture * waves.sum()
    stribeck = 1.0 + (velocity**2).sum(axis=1) / law.v_s**2  # (n,)
    longest = texture * (law.mu_k + (law.mu_s - law.mu_k) / stribeck) * state.pressure / law.k_t  # (n,)
    trial = state.bristle + velocity.T * law.step  # (2, n)
    length = np.hypot(*trial)  # (n,)
    slips = length > longest
    scale = np.divide(longest, length, out=np.ones_like(length), where=slips)
    state.bristle[:] = trial * scale
    load = state.pressure * law.area  # (n,) N
    slid = float((load * np.where(slips, length - longest, 0.0)).sum())
    force = -law.k_t * law.area * state.bristle  # (2, n) N
    total = float(load.sum())
    friction = np.array([*force.sum(axis=1), (place.T * force).sum()])
    return friction, slid / (total * law.step) if total > 0.0 else 0.0


def swing(law: Law, state: State, drive: Reals, friction: Reals) -> None:
    """Move the tip on its spring by one step."""
    spring = np.array([law.spring, law.spring, law.twist_spring])
    damper = np.array([law.damper, law.damper, law.twist_damper])
    mass = np.array([law.mass, law.mass, law.inertia])
    push = np.array([drive[4], drive[5], 0.0])
    pull = spring * state.deflection + damper * (drive[:3] - state.velocity)
    state.velocity[:] += law.step / mass * (pull + friction + push)
    state.deflection[:] += law.step * (drive[:3] - state.velocity)
    state.path[0] += law.step * float(np.hypot(state.velocity[0], state.velocity[1]))


def advance(law: Law, pad: Pad, state: State, drive: Reals, until: Times) -> tuple[Reals, Reals]:
    """Run the scene and read it at chosen steps, as `contact.advance` does."""
    tractions, truth = np.empty((len(until), 3, len(pad.x))), np.empty((len(until), 2))
    done = 0
    for reading, last in enumerate(until):
        slid: list[float] = []
        for row in drive[done:last]:
            turn(law, pad, state, row[2])
            press(law, pad, state, row[3])
            friction, slide = rub(law, pad, state)
            swing(law, state, row, friction)
            state.friction[:] = friction[:2]
            slid.append(slide)
        done = last
        tractions[reading] = state.pressure, *(-law.k_t * state.bristle)
        truth[reading] = np.mean(slid) if slid else 0.0, (state.pressure * law.area).sum()
    return tractions, truth
