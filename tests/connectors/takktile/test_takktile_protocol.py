import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from connectors.takktile.takktile_protocol import Coefficients, OverloadDetector, Reading

BYTES = "3ECE B3F9 C517 33C8"
DATASHEET = Coefficients(2009.75, -2.3758544921875, -0.92047119140625, 0.0007901191711425781)


def flipped(bit: int) -> bytes:
    """Return the datasheet's coefficients with a wrong bit."""
    return (int.from_bytes(bytes.fromhex(BYTES), "big") ^ 1 << bit).to_bytes(8, "big")


def test_counts_become_pressure_as_in_the_datasheet() -> None:
    assert Coefficients.decode(bytes.fromhex(BYTES)) == DATASHEET
    found = [DATASHEET.pressure(counts, 507.0) for counts in (410, 372, 263, 781, 0)]
    assert found == pytest.approx([96.587, 101.325, 115.0, 50.0, 148.0], abs=0.1)  # counts fall as it rises


def test_coefficients_are_signed_and_c12_has_two_unused_bits() -> None:
    found = Coefficients.decode(bytes.fromhex("3ECE B3F9 C517 33CB"))
    assert found == DATASHEET._replace(c12=0x33C8 / 2**24)


@given(st.binary(min_size=8, max_size=8) | st.integers(0, 63).map(flipped))
@example(bytes(8))  # an idle bus
@example(bytes([0xFF] * 8))
@example(bytes.fromhex("BECE B3F9 C517 33C8"))  # the sign of a0
@example(bytes.fromhex("CEB3 F9C5 1733 C800"))  # one byte lost
@example(bytes.fromhex("3ECE 0000 0000 0000"))
def test_coefficients_that_no_barometer_has_are_none(data: bytes) -> None:
    a0, b1, b2, c12 = struct.unpack(">4h", data)
    at_example = (a0 / 8 + (b1 / 8192 + (c12 >> 2) / 2**22 * 507) * 410 + b2 / 16384 * 507) * 65 / 1023 + 50
    possible = a0 > 0 and b1 < 0 and b2 < 0 and c12 >= 0 and 50 <= at_example <= 115
    assert (Coefficients.decode(data) is not None) == possible


@given(st.integers(0, 1023), st.integers(0, 1023), st.integers(0, 63))
def test_a_reading_is_two_left_aligned_unsigned_10_bit_numbers(p: int, t: int, rest: int) -> None:
    data = (p << 6 | rest).to_bytes(2, "big") + (t << 6 | rest).to_bytes(2, "big")
    assert Reading.decode(data) == (p, t)


def test_an_implausible_temperature_is_detected() -> None:
    assert Reading(410, 507).plausible
    assert Reading(0, 498).plausible  # overloaded, not dead
    for pressure, temperature in ((0, 0), (1023, 1023), (410, 0), (410, 1023)):
        assert not Reading(pressure, temperature).plausible


@given(st.integers(380, 511), st.lists(st.integers(-450, 450), max_size=100))
def test_an_overload_is_detected_if_steps_are_below_half_the_range(start: int, steps: list[int]) -> None:
    cell, true = OverloadDetector(), start
    assert cell.valid(start)
    for step in steps:
        true = min(max(true + step, -400), 511)
        assert cell.valid(true % 1024) == (true >= 0)
