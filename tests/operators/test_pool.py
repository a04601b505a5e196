from dataclasses import replace

import numpy as np
import pytest

from operators import Pool, Touch
from operators.errors import FingertipError, ParameterError
from operators.fingertip import TAKKTILE, Fingertip, grid

PAD = Fingertip(grid(16), 1000.0, "kPa", 0.01, (0, 4000))
SIX = ((8, 12), (9, 10, 13, 14), (11, 15), (3, 7), (1, 2, 5, 6), (0, 4))


def rows(counts: list[list[int]], valid: list[list[bool]] | bool = True) -> Touch:
    return Touch.rows(range(len(counts)), counts, np.array(counts) + 1, valid, finger=2)


def test_a_group_is_the_mean_of_its_valid_cells_times_the_gain() -> None:
    touch = rows([[1, 2, 6, 100]] * 3, [[True] * 4, [True, True, False, True], [True, False, False, False]])
    pooled = Pool(((0, 1, 2), (3,)), gain=-2.0).push(touch)
    assert pooled.counts.tolist() == [[-6, -200], [-3, -200], [-2, 0]]
    assert pooled.temperature.tolist() == [[4, 101], [3, 101], [2, 0]]
    assert pooled.valid.tolist() == [[True, True], [True, True], [False, False]]
    assert (type(pooled), pooled.finger) == (Touch, 2)


def test_counts_beyond_16_bits_are_limited() -> None:
    assert Pool(gain=3.0).push(rows([[30_000, -30_000]])).counts.tolist() == [[32767, -32768]]


def test_sixteen_taxels_in_kilopascals_become_the_fingertip_of_the_shipped_detectors() -> None:
    made = Pool(SIX, gain=-0.25, unit="count").output_fingertip(PAD)
    assert made == Fingertip(TAKKTILE.layout, 1000.0, "count", 1.0)
    TAKKTILE.check_fits("tcn", replace(made, rate=100.0))


def test_without_another_unit_the_readings_stay_the_same() -> None:
    made = Pool(gain=0.5).output_fingertip(PAD)
    assert (made.layout, made.unit, made.resolution, made.range) == (PAD.layout, "kPa", 0.02, (0, 2000))


def test_a_fingertip_without_the_cells_of_a_group_is_refused() -> None:
    with pytest.raises(FingertipError, match="Pool needs 16 cells; the data has 6 cells"):
        Pool(SIX).output_fingertip(TAKKTILE)
    with pytest.raises(ParameterError, match="cells below 2: the fingertip has 2 cells"):
        Pool(SIX).push(rows([[1, 2]]))
