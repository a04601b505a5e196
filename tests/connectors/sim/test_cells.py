import numpy as np
import pytest

from connectors.sim.cells import ROOM_TEMPERATURE, Cells
from connectors.sim.pad_sensor import CEILING
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Faults
from operators.batch import Reals

T = np.arange(50) / 100
QUIET = Parameters()


def cells(faults: Faults, parameters: Parameters = QUIET) -> Cells:
    body, noise, warmth = np.random.default_rng(1).spawn(3)
    return Cells(parameters, faults, body, noise, warmth)


def pressed(pressure: float, rows: int = 50) -> Reals:
    """An even pressure on the whole pad (rows, 3, n)."""
    tractions = np.zeros((rows, 3, QUIET.columns * QUIET.rows))
    tractions[:, 0] = pressure
    return tractions


def test_cells_read_their_rest_in_the_air_and_less_under_pressure() -> None:
    air, temperature, valid = cells(Faults()).read(T, pressed(0.0), 0.0125)
    touched, _, _ = cells(Faults()).read(T, pressed(5000.0), 0.0125)
    assert (air == air[0]).all()
    assert ((air >= QUIET.rest_lowest) & (air <= QUIET.rest_highest)).all()
    assert (touched < air).all()
    assert (np.diff(touched.astype(int), axis=0) <= 0).all()  # it creeps
    assert np.abs(temperature - ROOM_TEMPERATURE).max() <= 10
    assert valid.all()


def test_a_reading_cut_in_two_is_the_same() -> None:
    noisy = Parameters(noise=0.7)
    whole = cells(Faults(), noisy).read(T, pressed(3000.0), 0.0125)
    halves = cells(Faults(), noisy)
    first, second = (halves.read(T[rows], pressed(3000.0, 25), 0.0125) for rows in (slice(25), slice(25, 50)))
    for one, a, b in zip(whole, first, second, strict=True):
        np.testing.assert_array_equal(one, np.concatenate([a, b]))


def test_each_fault_is_that_of_its_cell() -> None:
    faults = Faults(dead=(0,), stuck=(1,), floored=(2,), offset=(0, 0, 0, 9, 0, 0), drift=(0, 0, 0, 0, 10, 0))
    clean, _, _ = cells(Faults()).read(T, pressed(2000.0), 0.0125)
    counts, _, valid = cells(faults).read(T, pressed(2000.0), 0.0125)
    assert valid[0].tolist() == [False, True, True, True, True, True]
    assert not counts[:, [0, 2]].any()
    assert (counts[:, 1] == clean[0, 1]).all()
    np.testing.assert_array_equal(counts[:, 3], clean[:, 3] + 9)
    assert counts[-1, 4] - clean[-1, 4] == pytest.approx(10 * T[-1], abs=1)
    np.testing.assert_array_equal(counts[:, 5], clean[:, 5])


def test_counts_stay_within_the_converter() -> None:
    high, _, _ = cells(Faults(offset=(2000,) * 6)).read(T, pressed(0.0), 0.0125)
    low, _, _ = cells(Faults()).read(T, pressed(1e6), 0.0125)
    assert (high == CEILING).all()
    assert not low.any()
