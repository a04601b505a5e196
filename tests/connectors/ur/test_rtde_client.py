"""Connections to test peers, which also violate the protocol."""

import asyncio
import logging
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.ur import rtde_client
from connectors.ur.rtde import Kind, pack
from connectors.ur.rtde_client import RtdeClient
from connectors.ur.ur_motion import OUTPUTS
from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from operators import EndpointError
from tests.emulators.rtde_recipe import Recipe, Request, version_payload
from tests.emulators.ur_controller import CB3

HOST = "127.0.0.1"
NAMES, TYPES = tuple(OUTPUTS), tuple(OUTPUTS.values())


class TestTransport(asyncio.Transport):
    """Transport that drops what is written to it and delivers what the test says."""

    __test__ = False

    def write(self, data: bytes | bytearray | memoryview) -> None:
        del data

    def pause_reading(self) -> None:
        pass

    def resume_reading(self) -> None:
        pass


RECIPE = Recipe(7, NAMES, TYPES)
ANSWERS = [
    pack(Kind.PROTOCOL, b"\1"),
    pack(Kind.CONTROLLER, version_payload(CB3)),
    pack(Kind.OUTPUTS, RECIPE.answer),
    pack(Kind.START, b"\1"),
]
DATA = [RECIPE.pack((k / 125, (k, 0, 0, 0, 0, 0), (0.0,) * 6)) for k in range(3)]


def client() -> RtdeClient:
    """Return a client that is connected."""
    connected = RtdeClient(LoopClock(), HOST, 1, OUTPUTS, rate=125.0, timeout=1.0)
    connected.connection_made(TestTransport())
    return connected


def fed(pieces: list[bytes]) -> tuple[bytes, str]:
    """Return the payloads that a client receives from pieces of a byte stream, and why it fails."""

    async def main() -> tuple[bytes, str]:
        reader, received = client(), b""
        for piece in pieces:
            reader.data_received(piece)
        reader.connection_lost(ConnectionError("end of the test"))
        try:
            while True:
                received += (await reader.receive())[1].tobytes()
        except EndpointError as error:
            return received, error.reason

    return run_virtually(main())


@given(st.lists(st.integers(0, 700), max_size=20))
def test_any_cut_of_a_connection_gives_the_same_data(cuts: list[int]) -> None:
    stream = b"".join([*ANSWERS, *(pack(Kind.DATA, payload) for payload in DATA)])
    places = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    received, reason = fed([stream[start:stop] for start, stop in pairwise(places)])
    assert (received, reason) == (b"".join(DATA), "end of the test")


@pytest.mark.parametrize(
    ("answers", "wrong", "reason"),
    [
        (0, pack(Kind.PROTOCOL, b"\0"), "does not support RTDE version 2"),
        (0, pack(Kind.CONTROLLER, version_payload(CB3)), "'v', expected 'V'"),
        (0, pack(Kind.DATA, DATA[0]), "'U', expected 'V'"),
        (1, pack(Kind.CONTROLLER, b"\1"), "version has 1 bytes"),
        (2, pack(Kind.OUTPUTS, b"\0DOUBLE,NOT_FOUND"), "actual_TCP_pose NOT_FOUND"),
        (2, pack(Kind.OUTPUTS, b"\1DOUBLE,VECTOR6D,VECTOR3D"), "actual_TCP_speed as VECTOR3D"),
        (3, pack(Kind.START, b"\0"), "refused to start"),
        (3, pack(Kind.DATA, DATA[0]), "'U', expected 'S'"),
        (4, pack(Kind.DATA, DATA[0][:-1]), "data of 104 bytes"),
        (4, pack(Kind.DATA, b"\1" + DATA[0][1:]), "recipe 01, not 105 for 07"),
        (4, pack(Request.PAUSE, b"\1"), "'P', expected 'U'"),
        (4, b"HTTP/1.1 400 Bad Request", "package of 18516 bytes"),
    ],
)
def test_an_unexpected_package_is_an_error_after_the_data_before_it(
    answers: int, wrong: bytes, reason: str
) -> None:
    before = [*ANSWERS[:answers], *([pack(Kind.DATA, DATA[0])] if answers == 4 else [])]
    received, error = fed([b"".join([*before, wrong])])
    assert reason in error
    assert received == (DATA[0] if answers == 4 else b"")


@given(st.lists(st.binary(max_size=60), min_size=1, max_size=9), st.integers(1, 300))
def test_messages_of_the_controller_are_counted_and_a_few_are_logged(texts: list[bytes], often: int) -> None:
    flood = b"".join(pack(Kind.TEXT, payload) for payload in texts) * often
    logged = list[str]()

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            logged.append(record.getMessage())

    async def main() -> tuple[int, bytes]:
        reader = client()
        reader.data_received(b"".join([*ANSWERS, flood, pack(Kind.DATA, DATA[0]), flood]))
        return reader.texts, (await reader.receive())[1].tobytes()

    collector = Collector()
    logging.getLogger("slipflow").addHandler(collector)
    try:
        count, received = run_virtually(main())
    finally:
        logging.getLogger("slipflow").removeHandler(collector)
    assert (count, received) == (2 * often * len(texts), DATA[0])
    assert len(logged) == min(count, rtde_client.TEXTS + 1)
    assert all(line.isprintable() for line in logged)
