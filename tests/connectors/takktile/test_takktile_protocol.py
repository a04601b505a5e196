import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.takktile.takktile_protocol import (
    ALL,
    BAROMETER,
    UNKNOWN,
    Coefficients,
    Converter,
    Reading,
    cell_address,
    celsius,
    compensate,
)

DATASHEET = Coefficients.decode(bytes.fromhex("3ECE B3F9 C517 33C8")) or UNKNOWN


def test_the_datasheets_example_is_96_587_kpa() -> None:
    np.testing.assert_allclose(DATASHEET, (2009.75, -2.37585, -0.92047, 0.00079012), atol=1e-5)
    assert DATASHEET.pressure(410, 507) == pytest.approx(96.587, abs=5e-4)


@pytest.mark.parametrize(("count", "kpa"), [(372, 101.325), (263, 115.0), (781, 50.0), (0, 148.0)])
def test_counts_fall_as_pressure_rises(count: int, kpa: float) -> None:
    assert DATASHEET.pressure(count, 507) == pytest.approx(kpa, abs=0.1)


def test_the_coefficients_are_signed_and_c12_has_two_bits_that_do_not_count() -> None:
    assert Coefficients.decode(bytes.fromhex("0008 2000 4000 0007")) == (1.0, 1.0, 1.0, 2**-22)
    assert Coefficients.decode(bytes.fromhex("FFF8 E000 C000 FFFC")) == (-1.0, -1.0, -1.0, -(2**-22))


@pytest.mark.parametrize("octet", [0x00, 0xFF])
def test_what_nobody_says_is_no_coefficient(octet: int) -> None:
    assert Coefficients.decode(bytes([octet] * 8)) is None


@given(st.integers(0, 1023), st.integers(0, 1023), st.integers(0, 63))
def test_a_reading_is_two_unsigned_numbers_of_10_bits_to_the_left(p: int, t: int, rest: int) -> None:
    data = (p << 6 | rest).to_bytes(2, "big") + (t << 6 | rest).to_bytes(2, "big")
    assert Reading.decode(data) == (p, t)


def test_what_no_barometer_can_have_converted_is_told() -> None:
    assert Reading(410, 507).converted
    assert Reading(0, 498).converted  # overloaded, not dead
    for pressure, temperature in ((0, 0), (1023, 1023), (410, 0), (410, 1023)):
        assert not Reading(pressure, temperature).converted


def test_each_cell_has_an_address_that_no_other_device_here_has() -> None:
    addresses = [cell_address(row, cell) for row in range(8) for cell in range(6)]
    assert len(set(addresses)) == 48
    assert not {ALL, BAROMETER} & set(addresses)
    assert cell_address(0, 6) == ALL
    assert [address << 1 for address in addresses[6:8]] == [
        0x10,
        0x12,
    ]  # on the wire: (row << 4) | (cell << 1)


def test_fingertips_are_compensated_cell_by_cell() -> None:
    counts = np.arange(400, 412, dtype=np.int16).reshape(2, 6)
    temperature = np.full((2, 6), 507, np.int16)
    other = DATASHEET._replace(a0=2000.0)
    cells: list[Coefficients | None] = [DATASHEET, other, None, DATASHEET, None, other]
    kpa = compensate(counts, temperature, cells)
    for cell, known in enumerate(cells):
        for row in range(2):
            expected = np.nan if known is None else known.pressure(counts[row, cell], 507)
            assert kpa[row, cell] == pytest.approx(expected, nan_ok=True)


def test_room_temperature_is_498_counts() -> None:
    assert celsius(np.array([[498]], np.int16)).tolist() == [[25.0]]


@given(st.lists(st.integers(0, 511)))
def test_counts_that_a_fingertip_can_have_are_believed(counts: list[int]) -> None:
    cell = Converter()
    assert all(map(cell.believe, counts))


@given(st.integers(380, 511), st.lists(st.integers(-450, 450), max_size=100))
def test_a_pressure_that_moves_less_than_half_the_range_at_once_is_followed_beyond_its_end(
    start: int, steps: list[int]
) -> None:
    cell, true = Converter(), start
    assert cell.believe(start)
    for step in steps:
        true = min(max(true + step, -400), 511)
        assert cell.believe(true % 1024) == (true >= 0)


def test_a_cell_that_was_silent_is_judged_by_its_count_alone() -> None:
    cell = Converter()
    assert [cell.believe(count) for count in (10, 1000, 700)] == [True, False, False]
    assert not cell.believe(None)
    assert [cell.believe(count) for count in (700, 1000)] == [True, False]
