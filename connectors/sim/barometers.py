"""From the tractions on the pad's face to the counts of the six barometers under the rubber.

Stress at depth z under a point load on an elastic half-space, rho from the load to the cell::

    normal load P      sigma_zz = 3 P z^3 / (2 pi r^5)         Boussinesq (Johnson 1985, section 3.2)
    shear load Q       sigma_zz = 3 Q . rho z^2 / (2 pi r^5)   Cerruti (Johnson 1985, section 3.6)

Both as compression (Pa), r^2 = rho^2 + z^2, integrated over each node's rectangle by the midpoint rule, so
that the node grid may be coarser than the depth. Shear counts `shear_gain` times: a fitted stand-in for what
the half-space leaves out, stiff cells in a thin sheet of rubber. A cell answers with a gain G (counts/Pa), of
which a share c creeps in with time constant T; counts fall as stress rises (MPL115A2 datasheet); 10 bits::

    late' = (sigma - late) / T          counts = rest - G ((1 - c) sigma + c late) + noise
"""

import math
from functools import lru_cache
from typing import Final

import numpy as np

from connectors.sim.contact import compiled
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Faults
from operators.batch import BAROMETERS, Counts, Flags, Reals

CEILING: Final = 1023  # counts
FINE: Final = 8  # points per side of a node's rectangle


def grid(parameters: Parameters, fine: int = 1) -> tuple[Reals, Reals]:
    """Centres (x, y) (m) of the pad's nodes, row by row from the lower left; (rows * columns * fine**2,)."""
    p = parameters
    x = (np.arange(p.columns * fine) + 0.5) / (p.columns * fine) * p.width - p.width / 2
    y = (np.arange(p.rows * fine) + 0.5) / (p.rows * fine) * p.height - p.height / 2
    across, up = np.meshgrid(x, y)
    return across.ravel(), up.ravel()


def cell_positions(parameters: Parameters) -> Reals:
    """Places of the barometers, 5 4 3 over 0 1 2, x right, y up: (6, 2) m."""
    columns = np.array([-1, 0, 1, 1, 0, -1]) * parameters.pitch_x
    rows = np.array([-1, -1, -1, 1, 1, 1]) * parameters.pitch_y / 2
    return np.stack([columns, rows], axis=1)


@lru_cache(maxsize=16)
def influence(parameters: Parameters) -> Reals:
    """Compressive stress at each cell (Pa) per traction of each node (Pa): (6, 3, nodes), normal, x, y."""
    p = parameters
    x, y = grid(p, FINE)
    area = p.width * p.height / x.size
    rho = cell_positions(p)[:, None] - np.stack([x, y], axis=1)  # (6, points, 2) from the load to the cell
    r5 = ((rho**2).sum(axis=2) + p.depth**2) ** 2.5  # (6, points)
    load = 3 * area * p.depth**2 / (2 * math.pi * r5)  # (6, points)
    shear = p.shear_gain * load[:, None] * rho.transpose(0, 2, 1)  # (6, 2, points)
    stress = np.concatenate([load[:, None] * p.depth, shear], axis=1)  # (6, 3, points)
    patches = stress.reshape(BAROMETERS, 3, p.rows, FINE, p.columns, FINE)
    matrix = np.ascontiguousarray(patches.sum(axis=(3, 5)).reshape(BAROMETERS, 3, -1))
    matrix.flags.writeable = False
    return matrix


@compiled
def respond(tractions: Reals, matrix: Reals, response: tuple[float, float, float], late: Reals) -> Reals:
    """What the cells say, relative to their rest, before noise and rounding.

    Args:
        tractions: (k, 3, n) Pa.
        matrix: (6, 3, n) from `influence`.
        response: Gain G (counts/Pa), share c, and the part of the lag that one sample makes good.
        late: (6,) the lagging stress (Pa); changed in place.

    Returns:
        (k, 6) counts.
    """
    gain, share, gained = response
    counts = np.zeros((tractions.shape[0], matrix.shape[0]))
    for row in range(tractions.shape[0]):
        for cell in range(matrix.shape[0]):
            stress = 0.0
            for part in range(3):
                for node in range(matrix.shape[2]):
                    stress += matrix[cell, part, node] * tractions[row, part, node]
            late[cell] += gained * (stress - late[cell])
            counts[row, cell] = -gain * ((1.0 - share) * stress + share * late[cell])
    return counts


ROOM_TEMPERATURE = 498  # counts at 25 degC; datasheet


class Barometers:
    """Barometers that remember how they crept.

    Args:
        parameters: Of the fingertip.
        faults: What is wrong with them.
        body: Draws the rest levels and the offsets of their thermometers.
        noise: Draws the noise of pressure.
        warmth: Draws the noise of temperature.
    """

    def __init__(
        self,
        parameters: Parameters,
        faults: Faults,
        body: np.random.Generator,
        noise: np.random.Generator,
        warmth: np.random.Generator,
    ) -> None:
        p = self._p = parameters
        self._faults, self._noise, self._warmth = faults, noise, warmth
        self._influence = influence(p)
        self._late = np.zeros(BAROMETERS)
        self._rest = body.integers(p.rest_lowest, p.rest_highest, BAROMETERS, endpoint=True).astype(float)
        self._temperature = ROOM_TEMPERATURE + body.integers(-8, 8, BAROMETERS)
        self._held: Reals | None = None  # (6,) the first reading, which stuck cells repeat

    def read(self, t: Reals, tractions: Reals, aged: float) -> tuple[Counts, Counts, Flags]:
        """What the cells say at instants (k,) (s since the run began).

        Args:
            t: When they are read.
            tractions: (k, 3, n) Pa: pressure, shear along x, shear along y of each node.
            aged: Times of creep that pass from each instant to the next.

        Returns:
            Raw ADC counts of pressure (k, 6), of temperature (k, 6), and which cells answer (k, 6).
        """
        counts = self._counts(t, tractions, aged)
        valid = np.ones((len(t), BAROMETERS), np.bool_)
        valid[:, self._faults.dead] = False
        temperature = self._temperature + 0.3 * self._warmth.standard_normal((len(t), BAROMETERS))
        return counts, np.rint(temperature).astype(np.int16), valid

    def _counts(self, t: Reals, tractions: Reals, aged: float) -> Counts:
        """Raw ADC counts (k, 6) at instants (k,) (s), `aged` times of creep apart."""
        p, faults = self._p, self._faults
        gained = 1 - math.exp(-aged)
        counts = respond(tractions, self._influence, (p.sensitivity, p.creep, gained), self._late)
        if faults.gain:
            counts *= faults.gain
        counts += self._rest
        if faults.offset:
            counts += faults.offset
        if faults.drift:
            counts += t[:, None] * faults.drift
        if p.noise:
            counts += p.noise * self._noise.standard_normal(counts.shape)
        if faults.stuck:
            held = self._held = counts[0].copy() if self._held is None else self._held
            counts[:, faults.stuck] = held[list(faults.stuck)]
        if faults.floored or faults.dead:
            counts[:, faults.floored + faults.dead] = 0.0
        return np.clip(np.rint(counts), 0, CEILING).astype(np.int16)
