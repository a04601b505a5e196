from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.gripper.robotiq import (
    FAULTS,
    Fingers,
    Phase,
    Request,
    RobotiqError,
    Status,
    octets,
    registers,
)

HEADER = bytes.fromhex(
    "00 00 00 0D 02 10 00 00 00 03 06"
)  # after the transaction's two bytes, as the manual has it
octet = st.integers(0, 255)
requests = st.builds(Request, st.booleans(), st.booleans(), octet, octet, octet)


@pytest.mark.parametrize(
    ("frame", "request_"),
    [
        ("33 9A 00 00 00 0D 02 10 00 00 00 03 06 01 00 00 00 00 00", Request(active=True)),
        (
            "71 EE 00 00 00 0D 02 10 00 00 00 03 06 09 00 00 FF FF FF",
            Request(active=True, go=True, position=255, speed=255, force=255),
        ),
    ],
)
def test_requests_have_the_bytes_in_the_manual(frame: str, request_: Request) -> None:
    data = bytes.fromhex(frame)
    assert data[2:] == HEADER + request_.encode()
    assert Request.decode(data[-6:]) == request_


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


@given(requests)
def test_requests_are_restored_from_bytes(request_: Request) -> None:
    assert Request.decode(request_.encode()) == request_
    assert octets(registers(request_.encode())) == request_.encode()


@given(st.binary(min_size=16, max_size=16))
def test_any_sixteen_bytes_are_a_status(data: bytes) -> None:
    status = Status.decode(data)
    assert status.reason if status.fault else not status.reason


@pytest.mark.parametrize("size", [0, 2, 15, 17])
def test_a_status_of_another_size_is_refused(size: int) -> None:
    with pytest.raises(RobotiqError, match=f"a status of {size} bytes"):
        Status.decode(bytes(size))


def test_a_short_request_is_refused_and_a_longer_one_is_read() -> None:
    with pytest.raises(RobotiqError, match="a request of 5 bytes"):
        Request.decode(bytes(5))
    request = Request(active=True, go=True, position=9, speed=8, force=7)
    assert Request.decode(request.encode() + bytes(10)) == request


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
