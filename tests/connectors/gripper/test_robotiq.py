from dataclasses import replace
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.gripper.robotiq import FAULTS, Fingers, ForceScale, Phase, Request, Status, octets, registers
from operators import ParameterError

MEASURED = ForceScale(((0, 12.0), (40, 30.0), (255, 65.0)))


@pytest.mark.parametrize(
    ("frame", "request_"),
    [
        ("01 00 00 00 00 00", Request(active=True)),
        ("09 00 00 FF FF FF", Request(active=True, go=True, position=255, speed=255, force=255)),
    ],
)
def test_requests_have_the_bytes_in_the_manual(frame: str, request_: Request) -> None:
    data = request_.encode()
    assert data == bytes.fromhex(frame)
    assert octets(registers(data)) == data


@pytest.mark.parametrize(
    ("data", "state", "echo", "positions"),
    [
        ("11 00" + " 00" * 14, (1, 0), 0, (0, 0, 0)),
        ("31 00" + " 00" * 14, (3, 0), 0, (0, 0, 0)),
        ("39 C0 00 00 B8 0B 00 BD 0E 00 BA 0B 00 89 00 00", (3, 0), 0, (0xB8, 0xBD, 0xBA)),
        ("B9 EA 00 FF BC 00 00 C1 00 00 BD 00 00 89 00 00", (3, 2), 255, (0xBC, 0xC1, 0xBD)),
        ("F9 FF 00 00 07 00 00 06 00 00 06 00 00 89 00 00", (3, 3), 0, (7, 6, 6)),
    ],
)
def test_the_answers_in_the_manual_are_decoded(
    data: str, state: tuple[int, int], echo: int, positions: tuple[int, ...]
) -> None:
    status = Status.decode(bytes.fromhex(data))
    assert status.active
    assert (status.phase, status.fingers) == state
    assert (status.echo, status.positions, status.fault) == (echo, positions, 0)


@given(st.binary(min_size=16, max_size=16))
def test_any_sixteen_bytes_are_a_status(data: bytes) -> None:
    status = Status.decode(data)
    assert status.reason if status.fault else not status.reason
    with pytest.raises(ValueError, match="a status of 15 bytes"):
        Status.decode(data[:-1])


def test_fingers_that_stop_before_the_target_detect_an_object() -> None:
    held = Status(active=True, go=True, phase=Phase.READY, fingers=Fingers.ALL_STOPPED)
    assert held.object_detected
    assert replace(held, fingers=Fingers.SOME_STOPPED).object_detected
    for other in (
        replace(held, fingers=Fingers.MOVING),
        replace(held, fingers=Fingers.ARRIVED),
        replace(held, go=False),
        replace(held, phase=Phase.CHANGING),
        replace(held, active=False),
    ):
        assert not other.object_detected


def test_faults_that_need_a_reset_are_recognised() -> None:
    assert [fault for fault in FAULTS if Status(fault=fault).needs_reset] == [0x0B, 0x0D, 0x0E, 0x0F]
    assert Status(fault=0x0C).needs_reset  # unknown ones of that rank are not worked around
    assert "0x0c" in Status(fault=0x0C).reason


@given(st.integers(0, 255), st.sampled_from([ForceScale(), MEASURED]))
def test_registers_and_forces_convert_both_ways(register: int, scale: ForceScale) -> None:
    assert scale.register(scale.force(register)) == register


@given(st.floats(15.0, 60.0))
def test_the_requested_force_is_at_most_one_step_below_the_wanted_one(force: float) -> None:
    scale = ForceScale()
    assert force - 0.1765 < scale.force(scale.register(force)) <= force + 1e-6


def test_forces_outside_the_scale_are_clipped_and_linear_between_points() -> None:
    assert [MEASURED.register(force) for force in (-inf, 0.0, 11.0, 66.0, inf)] == [0, 0, 0, 255, 255]
    assert (MEASURED.weakest, MEASURED.strongest) == (12.0, 65.0)
    assert (MEASURED.force(20), MEASURED.register(21.0)) == (21.0, 20)


@pytest.mark.parametrize(
    "points",
    [
        (),
        ((0, 15.0),),
        ((1, 15.0), (255, 60.0)),
        ((0, 15.0), (254, 60.0)),
        ((0, 0.0), (255, 60.0)),
        ((0, 15.0), (255, inf)),
        ((0, 15.0), (255, nan)),
        ((0, 15.0), (100, 15.0), (255, 60.0)),
        ((0, 15.0), (100, 20.0), (100, 25.0), (255, 60.0)),
    ],
)
def test_points_that_are_no_scale_are_refused(points: tuple[tuple[int, float], ...]) -> None:
    with pytest.raises(ParameterError, match="ForceScale: points"):
        ForceScale(points)
