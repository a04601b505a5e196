"""The equations of `connectors.sim.contact` in plain array arithmetic: slow, short, its judge.

Stick-slip is chaotic, so the two agree to rounding until the first node slips, and in statistics after that.
"""

import numpy as np

from connectors.sim.contact import ContactModel, FingerState, Pad
from operators.batch import Reals


def balance_normal(model: ContactModel, pad: Pad, state: FingerState, force: float) -> None:
    """Balance the normal force and the tilting moments."""
    if force <= 0.0:
        state.pressed[:] = 0.0
        state.pressure[:] = 0.0
        return
    shape = np.stack([np.ones_like(pad.x), pad.x, pad.y])  # (3, n) overlap = attitude @ shape - gap
    springs = np.diag([0.0, model.tilt_spring, model.tilt_spring])
    rest = model.tilt_spring * np.array([0.0, model.tilt_x, model.tilt_y])
    rest[1:] -= model.lever * state.friction
    rest[0] = force
    if not state.pressed.any():
        state.pressed[:] = 1.0
    for _ in range(12):
        weight = model.k_n * model.area * state.pressed  # (n,)
        state.attitude[:] = np.linalg.solve(
            shape * weight @ shape.T + springs, rest + shape @ (weight * pad.gap)
        )
        overlap = state.attitude @ shape - pad.gap  # (n,)
        before = state.pressed.copy()
        state.pressed[:] = np.where(overlap > 0.0, 1.0, 0.0)
        state.pressure[:] = model.k_n * np.maximum(overlap, 0.0)
        if (before == state.pressed).all():
            break


def update_friction(model: ContactModel, pad: Pad, state: FingerState) -> tuple[Reals, float]:
    """Move the bristles by one step; the friction (3,) (N, N, N m) on the tip and its sliding speed (m/s)."""
    place = np.stack([-pad.y, pad.x], axis=1)  # (n, 2) velocity of a node per spin
    velocity = state.velocity[:2] + state.velocity[2] * place  # (n, 2)
    waves = np.sin(state.path[0] * np.array([model.wave_1, model.wave_2]))
    texture = 1.0 + 0.5 * model.texture * (waves[0] - waves[1])
    stribeck = 1.0 + (velocity**2).sum(axis=1) / model.v_s**2  # (n,)
    longest = (
        texture * (model.mu_k + (model.mu_s - model.mu_k) / stribeck) * state.pressure / model.k_t
    )  # (n,)
    trial = state.bristle + velocity.T * model.step  # (2, n)
    length = np.hypot(*trial)  # (n,)
    slips = length > longest
    scale = np.divide(longest, length, out=np.ones_like(length), where=slips)
    state.bristle[:] = trial * scale
    load = state.pressure * model.area  # (n,) N
    slid = float((load * np.where(slips, length - longest, 0.0)).sum())
    force = -model.k_t * model.area * state.bristle  # (2, n) N
    total = float(load.sum())
    friction = np.array([*force.sum(axis=1), (place.T * force).sum()])
    return friction, slid / (total * model.step) if total > 0.0 else 0.0


def move_tip(model: ContactModel, state: FingerState, drive: Reals, friction: Reals) -> None:
    """Move the tip on its spring by one step."""
    spring = np.array([model.spring, model.spring, model.twist_spring])
    damper = np.array([model.damper, model.damper, model.twist_damper])
    mass = np.array([model.mass, model.mass, model.inertia])
    push = np.array([drive[4], drive[5], 0.0])
    pull = spring * state.deflection + damper * (drive[:3] - state.velocity)
    state.velocity[:] += model.step / mass * (pull + friction + push)
    state.deflection[:] += model.step * (drive[:3] - state.velocity)
    state.path[0] += model.step * float(np.hypot(state.velocity[0], state.velocity[1]))
