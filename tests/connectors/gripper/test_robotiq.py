from math import inf
from struct import unpack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.gripper.robotiq import FAULTS, Status, force_register
from tests.emulators.gripper import register_force


@pytest.mark.parametrize(
    ("data", "status"),
    [
        ("11 00" + " 00" * 14, Status(active=True)),
        ("31 00" + " 00" * 14, Status(active=True, ready=True)),
        ("39 C0 00 00 B8 0B 00 BD 0E 00 BA 0B 00 89 00 00", Status(active=True, ready=True)),
        ("F9 FF 00 00 07 00 00 06 00 00 06 00 00 89 00 00", Status(active=True, ready=True)),
    ],
)
def test_the_answers_in_the_manual_are_decoded(data: str, status: Status) -> None:
    assert Status.decode(unpack(">8H", bytes.fromhex(data))) == status


@given(st.lists(st.integers(0, 0xFFFF), min_size=8, max_size=8))
def test_any_eight_registers_are_a_status(values: list[int]) -> None:
    status = Status.decode(values)
    assert bool(status.reason) == bool(status.fault)
    with pytest.raises(ValueError, match="a status of 7 registers"):
        Status.decode(values[:-1])


def test_faults_that_need_a_reset_are_recognised() -> None:
    assert [fault for fault in FAULTS if Status(fault=fault).needs_reset] == [0x0B, 0x0D, 0x0E, 0x0F]
    assert Status(fault=0x0C).needs_reset  # unknown ones of that rank are not worked around
    assert "0x0c" in Status(fault=0x0C).reason


@given(st.integers(0, 255), st.floats(15.0, 60.0))
def test_registers_and_forces_convert_both_ways(register: int, force: float) -> None:
    assert force_register(register_force(register)) == register
    assert force - 0.1765 < register_force(force_register(force)) <= force + 1e-6
    assert [force_register(each) for each in (-inf, 0.0, 14.9, 61.0, inf)] == [0, 0, 0, 255, 255]
