import numpy as np
import pytest
from scipy.integrate import dblquad

from connectors.sim.pad_sensor import cells, grid, influence, respond
from connectors.sim.physics_parameters import Parameters

MIRROR_X = [2, 1, 0, 5, 4, 3]
MIRROR_Y = [5, 4, 3, 2, 1, 0]


def test_the_cells_lie_as_on_the_fingertip() -> None:
    x, y = cells(Parameters()).T
    assert x.tolist() == sorted(x[:3].tolist()) + sorted(x[:3].tolist(), reverse=True)
    assert (y[:3] < 0).all()
    assert (y[3:] > 0).all()


def test_the_influence_is_the_integral_of_the_point_loads() -> None:
    p = Parameters()
    x, y = grid(p)
    node, cell = 12, 0
    cx, cy = cells(p)[cell]
    half_x, half_y = p.width / p.columns / 2, p.height / p.rows / 2

    def stress(part: int) -> float:
        def point(v: float, u: float) -> float:
            rho = np.array([cx - u, cy - v])
            r5 = (rho @ rho + p.depth**2) ** 2.5
            across = p.depth**3 if part == 0 else p.shear_gain * p.depth**2 * rho[part - 1]
            return float(3 * across / (2 * np.pi * r5))

        return dblquad(point, x[node] - half_x, x[node] + half_x, y[node] - half_y, y[node] + half_y)[0]

    assert influence(p)[cell, :, node] == pytest.approx([stress(part) for part in range(3)], rel=0.01)


def test_even_pressure_comes_through_under_the_middle_of_the_pad() -> None:
    middle = influence(Parameters(pitch_x=0.004, pitch_y=0.001)).sum(axis=2)[:, 0]
    assert (middle > 0.9).all()
    assert (middle < 1.0).all()


def test_the_influence_has_the_symmetry_of_the_pad() -> None:
    p = Parameters()
    matrix = influence(p).reshape(6, 3, p.rows, p.columns)
    sign_x, sign_y = np.array([1, -1, 1])[:, None, None], np.array([1, 1, -1])[:, None, None]
    np.testing.assert_allclose(matrix[MIRROR_X][..., ::-1] * sign_x, matrix, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(matrix[MIRROR_Y][..., ::-1, :] * sign_y, matrix, rtol=1e-9, atol=1e-15)


def test_pressing_lowers_the_counts_and_creep_lowers_them_further() -> None:
    p = Parameters()
    tractions = np.zeros((500, 3, p.columns * p.rows))
    tractions[:, 0] = 5e3
    late = np.zeros(6)
    counts = respond(tractions, influence(p), (p.sensitivity, 0.3, 1 - np.exp(-0.01 / 0.8)), late)
    assert (np.diff(counts, axis=0) < 0).all()
    np.testing.assert_allclose(counts[0] / counts[-1], 0.7, atol=0.01)


def test_shear_presses_behind_the_load_it_drags() -> None:
    """Friction on the pad points against the motion; the rubber piles up where it points to."""
    p = Parameters()
    x, y = grid(p)
    middle = int(np.argmin(x**2 + y**2))
    matrix = influence(p)
    right = cells(p)[:, 0] > x[middle]
    assert (matrix[right, 1, middle] > 0).all()
    assert (matrix[~right, 1, middle] <= 0).all()
