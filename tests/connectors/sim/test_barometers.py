from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import dblquad

from connectors.sim.barometers import (
    CEILING,
    DECADES,
    Barometers,
    cell_positions,
    grid,
    influence,
    respond,
)
from connectors.sim.scene import Parameters
from operators.batch import Reals


def test_the_influence_is_the_integral_of_the_point_loads() -> None:
    p = Parameters()
    x, y = grid(p)
    node, cell = 12, 0
    cx, cy = cell_positions(p)[cell]
    half_x, half_y = p.width / p.columns / 2, p.height / p.rows / 2

    def stress(part: int) -> float:
        def point(v: float, u: float) -> float:
            rho = np.array([cx - u, cy - v])
            r5 = (rho @ rho + p.depth**2) ** 2.5
            across = p.depth**3 if part == 0 else p.shear_gain * p.depth**2 * rho[part - 1]
            return float(3 * across / (2 * np.pi * r5))

        return dblquad(point, x[node] - half_x, x[node] + half_x, y[node] - half_y, y[node] + half_y)[0]

    assert influence(p)[cell, :, node] == pytest.approx([stress(part) for part in range(3)], rel=0.01)


def test_pressing_lowers_the_counts_and_relaxation_raises_them_with_the_logarithm_of_time() -> None:
    p = Parameters()
    tractions = np.zeros((801, 3, p.columns * p.rows))
    tractions[:, 0] = 5e3
    late, passed = np.zeros((3, 6)), 1 - np.exp(-0.01 / DECADES)
    counts = respond(tractions, influence(p), (p.sensitivity, 0.1), passed, late)
    assert (counts < 0).all()
    assert (np.diff(counts, axis=0) > 0).all()
    left = counts[[50, 100, 200, 400, 800], 0] / counts[0, 0]
    assert -np.diff(left) == pytest.approx(0.1 * np.log10(2), rel=0.15)  # per doubling of time


T = np.arange(50) / 100
QUIET = Parameters(noise=0.0)


def cells(parameters: Parameters = QUIET) -> Barometers:
    return Barometers(parameters, 1)


def pressed(pressure: float, rows: int = 50) -> Reals:
    """An even pressure on the whole pad (rows, 3, n)."""
    tractions = np.zeros((rows, 3, QUIET.columns * QUIET.rows))
    tractions[:, 0] = pressure
    return tractions


def test_counts_stay_within_the_converter() -> None:
    high, _, _ = cells(replace(QUIET, rest_lowest=2000, rest_highest=2000)).read(pressed(0.0), 0.0125)
    low, _, _ = cells().read(pressed(1e6), 0.0125)
    assert (high == CEILING).all()
    assert not low.any()
