"""Six barometers under the rubber of the pad: raw counts from the tractions on its face.

Stress at depth z under a point load on an elastic half-space, rho from the load to the cell::

    normal load P      sigma_zz = 3 P z^3 / (2 pi r^5)         Boussinesq (Johnson 1985, section 3.2)
    shear load Q       sigma_zz = 3 Q . rho z^2 / (2 pi r^5)   Cerruti (Johnson 1985, section 3.6)

Both as compression (Pa), r^2 = rho^2 + z^2, integrated over each node's rectangle by the midpoint rule, so
that the node grid may be coarser than the depth. The response to shear is multiplied by `shear_gain`, fitted
to account for stiff cells in a thin sheet of rubber, which the half-space neglects. Under a held load the
rubber relaxes with the logarithm of time: three exponentials, whose time constants are a decade apart, take a
fraction R of the response each. Counts fall as stress rises (MPL115A2 datasheet), with 10 bits::

    late_j' = (sigma - late_j) / T_j     counts = rest - G (sigma - R sum late_j) + noise     G in counts/Pa
"""

import math
from functools import lru_cache
from typing import Final

import numpy as np

from connectors.sim.contact import compiled
from connectors.sim.scene import Faults, Parameters
from operators.batch import BAROMETERS, Counts, Flags, Reals

CEILING: Final = 1023  # counts, of 10 bits
ROOM_TEMPERATURE: Final = 498  # counts at 25 degC; datasheet
FINE: Final = 8  # integration points per side of a node's rectangle
GLITCH: Final = 3.0  # counts, median of a glitch
DECADES: Final = np.array([0.3, 3.0, 30.0])  # s, time constants of the relaxation


def grid(parameters: Parameters, fine: int = 1) -> tuple[Reals, Reals]:
    """Return centres (x, y) (m) of the nodes, row by row from the lower left; (rows * columns * fine**2,)."""
    p = parameters
    x = (np.arange(p.columns * fine) + 0.5) / (p.columns * fine) * p.width - p.width / 2
    y = (np.arange(p.rows * fine) + 0.5) / (p.rows * fine) * p.height - p.height / 2
    across, up = np.meshgrid(x, y)
    return across.ravel(), up.ravel()


def cell_positions(parameters: Parameters) -> Reals:
    """Return positions of the barometers, 5 4 3 above 0 1 2, x right, y up: (6, 2) m."""
    columns = np.array([-1, 0, 1, 1, 0, -1]) * parameters.pitch_x
    rows = np.array([-1, -1, -1, 1, 1, 1]) * parameters.pitch_y / 2
    return np.stack([columns, rows], axis=1)


@lru_cache(maxsize=16)
def influence(parameters: Parameters) -> Reals:
    """Return the compressive stress at each cell per traction of each node (Pa/Pa): (6, 3, nodes)."""
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
def respond(
    tractions: Reals, matrix: Reals, response: tuple[float, float], passed: Reals, late: Reals
) -> Reals:
    """Return counts relative to rest, before noise and rounding.

    Args:
        tractions: (k, 3, n) Pa.
        matrix: (6, 3, n) from `influence`.
        response: Gain G (counts/Pa) and fraction R.
        passed: (3,) share of each exponential that passes from sample to sample.
        late: (3, 6) lagging stress (Pa); changed in place.

    Returns:
        (k, 6) counts.
    """
    gain, fraction = response
    counts = np.zeros((tractions.shape[0], matrix.shape[0]))
    for row in range(tractions.shape[0]):
        for cell in range(matrix.shape[0]):
            stress = 0.0
            for part in range(3):
                for node in range(matrix.shape[2]):
                    stress += matrix[cell, part, node] * tractions[row, part, node]
            lost = 0.0
            for decade in range(passed.size):
                late[decade, cell] += passed[decade] * (stress - late[decade, cell])
                lost += late[decade, cell]
            counts[row, cell] = -gain * (stress - fraction * lost)
    return counts


def randoms(seed: int, finger: int) -> list[np.random.Generator]:
    """Return the generators of a fingertip: rest levels, timing, noise of pressure and of temperature."""
    return np.random.default_rng([seed, 2, finger]).spawn(4)


class Barometers:
    """Barometers of one fingertip with relaxation and faults.

    Args:
        parameters: Parameters of the fingertip.
        faults: Faults of the cells.
        seed: Random seed of rest levels and all noise.
        finger: Number of the fingertip.
    """

    def __init__(self, parameters: Parameters, faults: Faults, seed: int, finger: int = 0) -> None:
        p = self._p = parameters
        self._faults = faults
        offsets, _, self._noise, self._temperature_noise = randoms(seed, finger)
        self._influence = influence(p)
        self._late = np.zeros((len(DECADES), BAROMETERS))
        self._rest = offsets.integers(p.rest_lowest, p.rest_highest, BAROMETERS, endpoint=True).astype(float)
        self._temperature = ROOM_TEMPERATURE + offsets.integers(-8, 8, BAROMETERS)

    def read(self, t: Reals, tractions: Reals, aged: float) -> tuple[Counts, Counts, Flags]:
        """Read the cells at instants (k,) (s since the run began).

        Args:
            t: Instants.
            tractions: (k, 3, n) Pa: pressure, shear along x, shear along y of each node.
            aged: Time between instants (s).

        Returns:
            Raw ADC counts of pressure (k, 6), of temperature (k, 6), and validity (k, 6).
        """
        p, faults, passed = self._p, self._faults, 1 - np.exp(-aged / DECADES)
        counts = respond(tractions, self._influence, (p.sensitivity, p.relaxation), passed, self._late)
        counts *= faults.gain
        counts += self._rest
        counts += faults.offset
        counts += t[:, None] * faults.drift
        if p.noise:
            counts += p.noise * self._noise.standard_normal(counts.shape)
        if p.glitches:
            counts += self._disturbed(counts.shape, p.glitches * aged)
        temperature = self._temperature + 0.3 * self._temperature_noise.standard_normal(counts.shape)
        valid = np.ones(counts.shape, np.bool_)
        valid[:, : faults.dead] = False
        counts[:, : faults.dead] = 0.0
        counts = np.clip(np.rint(counts), 0, CEILING)
        return counts.astype(np.int16), np.rint(temperature).astype(np.int16), valid

    def _disturbed(self, shape: tuple[int, ...], probability: float) -> Reals:
        """Draw glitches (k, 6), counts: some in most cells, more often up than down, each in two samples."""
        random, rows = self._noise, shape[0]
        size: Reals = GLITCH * np.exp(0.8 * random.standard_normal(rows))  # (k,) counts
        size *= np.where(random.random(rows) < 0.7, 1.0, -1.0)
        size[random.random(rows) >= probability] = 0
        size[1:] += size[:-1] / 2
        return np.asarray(size[:, None] * random.uniform(0.3, 1.3, shape))
