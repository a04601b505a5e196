from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import dblquad

from connectors.sim.barometers import CEILING, DECADES, Barometers, cell_positions, grid, influence, respond
from connectors.sim.scene import Faults, Parameters
from operators.batch import Counts, Reals


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


def cells(faults: Faults, parameters: Parameters = QUIET) -> Barometers:
    return Barometers(parameters, faults, 1)


def pressed(pressure: float, rows: int = 50) -> Reals:
    """An even pressure on the whole pad (rows, 3, n)."""
    tractions = np.zeros((rows, 3, QUIET.columns * QUIET.rows))
    tractions[:, 0] = pressure
    return tractions


@pytest.mark.parametrize(
    ("faults", "expected"),
    [
        (Faults(dead=1, offset=9), lambda clean: clean + 9),
        (Faults(dead=1, drift=10), lambda clean: np.rint(clean + 10 * T[:, None])),
    ],
)
def test_each_fault_is_that_of_responding_cells(faults: Faults, expected: Callable[[Counts], Reals]) -> None:
    clean, _, _ = cells(Faults()).read(T, pressed(2000.0), 0.0125)
    counts, _, valid = cells(faults).read(T, pressed(2000.0), 0.0125)
    assert valid[0].tolist() == [False, True, True, True, True, True]
    assert not counts[:, 0].any()
    np.testing.assert_allclose(counts[:, 1:], expected(clean)[:, 1:], atol=1)


def test_counts_stay_within_the_converter() -> None:
    high, _, _ = cells(Faults(offset=2000)).read(T, pressed(0.0), 0.0125)
    low, _, _ = cells(Faults()).read(T, pressed(1e6), 0.0125)
    assert (high == CEILING).all()
    assert not low.any()
