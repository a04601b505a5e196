import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.takktile.takktile_protocol import (
    ALL,
    BAROMETER,
    Coefficients,
    OverloadDetector,
    Reading,
    absolute_pressure,
    cell_address,
)

DATASHEET = Coefficients(2009.75, -2.3758544921875, -0.92047119140625, 0.0007901191711425781)


def test_counts_become_pressure_as_in_the_datasheet() -> None:
    assert Coefficients.decode(bytes.fromhex("3ECE B3F9 C517 33C8")) == DATASHEET
    counts = np.array([[410, 372, 263, 781, 0, 410]], np.int16)
    kpa = absolute_pressure(counts, np.full((1, 6), 507, np.int16), [DATASHEET] * 5 + [None])
    expected = [96.587, 101.325, 115.0, 50.0, 148.0, np.nan]  # counts fall as pressure rises
    np.testing.assert_allclose(kpa, [expected], atol=0.1)


def test_coefficients_are_signed_and_c12_has_two_unused_bits() -> None:
    assert Coefficients.decode(bytes.fromhex("0008 2000 4000 0007")) == (1.0, 1.0, 1.0, 2**-22)
    assert Coefficients.decode(bytes.fromhex("FFF8 E000 C000 FFFC")) == (-1.0, -1.0, -1.0, -(2**-22))


@pytest.mark.parametrize("octet", [0x00, 0xFF])
def test_the_bytes_of_an_idle_bus_are_no_coefficients(octet: int) -> None:
    assert Coefficients.decode(bytes([octet] * 8)) is None


@given(st.integers(0, 1023), st.integers(0, 1023), st.integers(0, 63))
def test_a_reading_is_two_left_aligned_unsigned_10_bit_numbers(p: int, t: int, rest: int) -> None:
    data = (p << 6 | rest).to_bytes(2, "big") + (t << 6 | rest).to_bytes(2, "big")
    assert Reading.decode(data) == (p, t)


def test_an_implausible_temperature_is_detected() -> None:
    assert Reading(410, 507).plausible
    assert Reading(0, 498).plausible  # overloaded, not dead
    for pressure, temperature in ((0, 0), (1023, 1023), (410, 0), (410, 1023)):
        assert not Reading(pressure, temperature).plausible


def test_the_addresses_of_all_cells_differ() -> None:
    addresses = [cell_address(row, cell) for row in range(8) for cell in range(6)]
    assert len(set(addresses)) == 48
    assert not {ALL, BAROMETER} & set(addresses)
    assert cell_address(0, 6) == ALL
    assert [address << 1 for address in addresses[6:8]] == [
        0x10,
        0x12,
    ]  # on the wire: (row << 4) | (cell << 1)


@given(st.integers(380, 511), st.lists(st.integers(-450, 450), max_size=100))
def test_an_overload_is_detected_if_steps_are_below_half_the_range(start: int, steps: list[int]) -> None:
    cell, true = OverloadDetector(), start
    assert cell.valid(start)
    for step in steps:
        true = min(max(true + step, -400), 511)
        assert cell.valid(true % 1024) == (true >= 0)
