"""The six barometers of one fingertip: tractions on its pad to raw counts, each cell with its own faults."""

import math

import numpy as np

from connectors.sim.pad_sensor import CEILING, influence, respond
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Faults
from operators.batch import BAROMETERS, Counts, Flags, Reals

ROOM_TEMPERATURE = 498  # counts at 25 degC; datasheet


class Cells:
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
