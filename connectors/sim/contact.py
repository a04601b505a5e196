"""Contact of the pad with a surface: normal pressure, friction, and motion of the finger that carries it.

The pad is a grid of nodes at (x, y), each with an area A. All vectors are in the fingertip frame.

Normal contact (Winkler foundation, Johnson 1985, section 4.3; quasi-static)::

    overlap  delta = d + a x + b y - g           d depth (m), a and b tilts (rad), g gap to the surface (m)
    pressure p = k_n max(0, delta)               k_n normal stiffness (Pa/m)
    sum p A                          = F         F normal force (N), commanded
    sum p A x + k_a (a - a0) + h Q_x = 0         k_a tilt stiffness (N m/rad), h lever (m), a0 tilt at rest
    sum p A y + k_a (b - b0) + h Q_y = 0         Q friction on the tip (N): the leading edge digs in

Surface (a paraboloid fixed in the room, q the yaw of the arm about the TCP, r_0 from there to the pad)::

    g = k_x u^2 / 2 + k_y v^2 / 2                k_x, k_y curvatures (1/m)
    (u, v) = R(q) (r_0 + (x, y)) - r_0 - apex    only rotations move the surface under the pad

Friction (elasto-plastic bristles, Dahl 1968, limited by a Stribeck curve as in Canudas de Wit et al. 1995)::

    ds/dt = v - (plastic part)                   s bristle deflection (m), v velocity of the node (m/s)
    traction t = k_t s,  |t| <= mu(|v|) p        k_t shear stiffness (Pa/m); the excess is slip
    mu(v) = (mu_k + (mu_s - mu_k) / (1 + (v / v_s)^2)) (1 + c/2 (sin 2 pi l/L1 - sin 2 pi l/L2))
    Q = -sum t A                                 l path of the tip (m), c depth and L lengths of the texture

Finger (rigid tip with velocity w, spin o; spring deflection e to an arm that moves at V, spins at O)::

    m dw/dt = k e + c (V - w) + Q + P            P external force (N), such as a tap
    I do/dt = k_o e_o + c_o (O - o) + sum (y t_x - x t_y) A
    de/dt   = V - w,   de_o/dt = O - o

Steps are semi-implicit (symplectic) Euler. Frame rotation terms (m O w < 0.02 N) are left out.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from operators.batch import Reals, Times
from operators.compilation import compile_function

TINY: Final = 1e-300  # m, so that a bristle at rest has a direction

compiled = compile_function()
vectorized = compile_function(  # inline, with sums in any order so that they run on vector units
    forceinline=True, fastmath={"reassoc", "nsz", "nnan"}
)


class ContactModel(NamedTuple):
    """Constants of the equations, with the names used there."""

    step: float  # s
    area: float  # m2, of one node
    k_n: float  # Pa/m
    k_t: float  # Pa/m
    mu_s: float
    mu_k: float
    v_s: float  # m/s
    texture: float
    wave_1: float  # rad/m
    wave_2: float  # rad/m
    mass: float  # kg
    spring: float  # N/m
    damper: float  # N s/m
    inertia: float  # kg m2
    twist_spring: float  # N m/rad
    twist_damper: float  # N m s/rad
    tilt_spring: float  # N m/rad
    lever: float  # m
    tilt_x: float  # rad, a0
    tilt_y: float  # rad, b0
    k_x: float  # 1/m
    k_y: float  # 1/m
    apex_x: float  # m
    apex_y: float  # m
    pivot_x: float  # m, r_0
    pivot_y: float  # m


class Pad(NamedTuple):
    """Nodes of the pad."""

    x: Reals  # (n,) m
    y: Reals  # (n,) m
    gap: Reals  # (n,) m; changed in place when the surface turns


class FingerState(NamedTuple):
    """State of fingertip and contact, changed in place."""

    deflection: Reals  # (3,) m, m, rad: spring, e and e_o
    velocity: Reals  # (3,) m/s, m/s, rad/s: tip, w and o
    attitude: Reals  # (3,) m, rad, rad: d, a, b
    friction: Reals  # (2,) N: Q of the last step
    path: Reals  # (1,) m: l
    yaw: Reals  # (1,) rad: q
    pressure: Reals  # (n,) Pa
    bristle: Reals  # (2, n) m: s
    pressed: Reals  # (n,) 1 where in contact, else 0
    springs: Reals  # (9,) sums over the nodes in contact, see `sum_springs`; 0 in the air

    @classmethod
    def rest(cls, nodes: int) -> "FingerState":
        """Return a fingertip at rest in the air."""
        return cls(
            np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(1), np.zeros(1),
            np.zeros(nodes), np.zeros((2, nodes)), np.zeros(nodes), np.zeros(9),
        )  # fmt: skip


@vectorized
def sum_springs(model: ContactModel, pad: Pad, state: FingerState) -> None:
    """Sum the springs of the nodes in contact: moments 1, x, y, xx, xy, yy, and g, gx, gy of the gaps."""
    s, sx, sy, sxx, sxy, syy, sg, sgx, sgy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(pad.x.size):
        k = model.k_n * model.area * state.pressed[i]
        x, y, kg = pad.x[i], pad.y[i], k * pad.gap[i]
        s, sx, sy = s + k, sx + k * x, sy + k * y
        sxx, sxy, syy = sxx + k * x * x, sxy + k * x * y, syy + k * y * y
        sg, sgx, sgy = sg + kg, sgx + kg * x, sgy + kg * y
    sums = state.springs
    sums[0], sums[1], sums[2], sums[3], sums[4] = s, sx, sy, sxx, sxy
    sums[5], sums[6], sums[7], sums[8] = syy, sg, sgx, sgy


@vectorized
def rotate_surface(model: ContactModel, pad: Pad, state: FingerState, spin: float) -> None:
    """Rotate the surface under the pad by one step."""
    state.yaw[0] += spin * model.step
    cos, sin = math.cos(state.yaw[0]), math.sin(state.yaw[0])
    for i in range(pad.x.size):
        x, y = pad.x[i] + model.pivot_x, pad.y[i] + model.pivot_y
        u = cos * x - sin * y - model.pivot_x - model.apex_x
        v = sin * x + cos * y - model.pivot_y - model.apex_y
        pad.gap[i] = 0.5 * (model.k_x * u * u + model.k_y * v * v)
    if state.springs[0] != 0.0:
        sum_springs(model, pad, state)


@vectorized
def balance_normal(model: ContactModel, pad: Pad, state: FingerState, force: float) -> None:
    """Balance normal force and tilting moments by Newton's method over the set of nodes in contact.

    The springs are summed again only when that set has changed.
    """
    if force <= 0.0:
        state.pressed[:] = 0.0
        state.pressure[:] = 0.0
        state.springs[:] = 0.0
        return
    if state.springs[0] == 0.0:
        state.pressed[:] = 1.0
        sum_springs(model, pad, state)
    for _ in range(12):
        s, sx, sy, sxx, sxy, syy, sg, sgx, sgy = state.springs
        f = force + sg
        mx = model.tilt_spring * model.tilt_x - model.lever * state.friction[0] + sgx
        my = model.tilt_spring * model.tilt_y - model.lever * state.friction[1] + sgy
        # eliminate the depth, then solve the 2 x 2 system of the tilts
        axx, axy, ayy = (
            sxx + model.tilt_spring - sx * sx / s,
            sxy - sx * sy / s,
            syy + model.tilt_spring - sy * sy / s,
        )
        bx, by = mx - sx * f / s, my - sy * f / s
        determinant = axx * ayy - axy * axy
        a, b = (ayy * bx - axy * by) / determinant, (axx * by - axy * bx) / determinant
        d = (f - sx * a - sy * b) / s
        state.attitude[0], state.attitude[1], state.attitude[2] = d, a, b
        changed = 0.0
        for i in range(pad.x.size):
            overlap = d + a * pad.x[i] + b * pad.y[i] - pad.gap[i]
            pressed = 1.0 if overlap > 0.0 else 0.0
            changed += abs(pressed - state.pressed[i])
            state.pressed[i] = pressed
            state.pressure[i] = model.k_n * overlap * pressed
        if changed == 0.0:
            break
        sum_springs(model, pad, state)


@vectorized
def update_friction(
    model: ContactModel, pad: Pad, state: FingerState, force: float
) -> tuple[float, float, float, float]:
    """Move the bristles by one step; return friction (N, N, N m) on the tip and sliding speed (m/s)."""
    vx, vy, spin = state.velocity[0], state.velocity[1], state.velocity[2]
    texture = 1.0
    if model.texture > 0.0:
        path = state.path[0]
        texture += 0.5 * model.texture * (math.sin(model.wave_1 * path) - math.sin(model.wave_2 * path))
    inverse, rise = 1.0 / (model.v_s * model.v_s), model.mu_s - model.mu_k
    reach = texture / model.k_t
    along, across = state.bristle[0], state.bristle[1]
    sum_x, sum_y, moment, excess = 0.0, 0.0, 0.0, 0.0
    for i in range(pad.x.size):
        x, y, pressure = pad.x[i], pad.y[i], state.pressure[i]
        ux, uy = vx - spin * y, vy + spin * x
        sx, sy = along[i] + ux * model.step, across[i] + uy * model.step
        longest = reach * pressure * (model.mu_k + rise / (1.0 + (ux * ux + uy * uy) * inverse))
        length = math.sqrt(sx * sx + sy * sy) + TINY
        kept = min(longest / length, 1.0)
        sx, sy = sx * kept, sy * kept
        along[i], across[i] = sx, sy
        sum_x, sum_y, moment = sum_x + sx, sum_y + sy, moment + y * sx - x * sy
        excess += pressure * length * (1.0 - kept)
    k = model.k_t * model.area
    slide = excess * model.area / (force * model.step) if force > 0.0 else 0.0
    return -k * sum_x, -k * sum_y, k * moment, slide


@compiled
def move_tip(
    model: ContactModel, state: FingerState, drive: Reals, friction: tuple[float, float, float]
) -> None:
    """Move the tip on its spring by one step."""
    e, w = state.deflection, state.velocity
    h = model.step
    for axis in range(2):
        pull = model.spring * e[axis] + model.damper * (drive[axis] - w[axis])
        w[axis] += h / model.mass * (pull + friction[axis] + drive[4 + axis])
        e[axis] += h * (drive[axis] - w[axis])
    pull = model.twist_spring * e[2] + model.twist_damper * (drive[2] - w[2])
    w[2] += h / model.inertia * (pull + friction[2])
    e[2] += h * (drive[2] - w[2])
    state.path[0] += h * math.sqrt(w[0] * w[0] + w[1] * w[1])


@compiled
def simulate(
    model: ContactModel, pad: Pad, state: FingerState, drive: Reals, until: Times
) -> tuple[Reals, Reals]:
    """Simulate a scene and sample it at chosen steps.

    Args:
        model: Constants of the contact model.
        pad: Nodes, with gaps that change in place.
        state: State, changed in place.
        drive: (steps, 6) velocity of the arm at the pad (m/s, m/s, rad/s), normal force (N), push (N, N).
        until: (k,) number of steps before each sample, not decreasing.

    Returns:
        Pressure and tractions x and y on the pad (Pa), (k, 3, n); mean sliding speed since the last
        sample (m/s) and normal force (N), (k, 2).
    """
    tractions, truth = np.empty((until.size, 3, pad.x.size)), np.empty((until.size, 2))
    curved = model.k_x != 0.0 or model.k_y != 0.0
    done = 0
    for reading in range(until.size):
        slid = 0.0
        steps = until[reading] - done
        while done < until[reading]:
            if curved and drive[done, 2] != 0.0:
                rotate_surface(model, pad, state, drive[done, 2])
            balance_normal(model, pad, state, drive[done, 3])
            qx, qy, torque, slide = update_friction(model, pad, state, drive[done, 3])
            move_tip(model, state, drive[done], (qx, qy, torque))
            state.friction[0], state.friction[1] = qx, qy
            slid += slide
            done += 1
        force = 0.0
        for i in range(pad.x.size):
            tractions[reading, 0, i] = state.pressure[i]
            tractions[reading, 1, i] = -model.k_t * state.bristle[0, i]
            tractions[reading, 2, i] = -model.k_t * state.bristle[1, i]
            force += state.pressure[i] * model.area
        truth[reading, 0] = slid / steps if steps > 0 else 0.0
        truth[reading, 1] = force
    return tractions, truth
