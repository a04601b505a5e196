"""Connections to test peers, which also violate the protocol."""

import asyncio
from itertools import pairwise
from unittest.mock import MagicMock, patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.ur import rtde
from connectors.ur.rtde import Kind, RtdeClient, pack
from connectors.ur.ur_motion import OUTPUTS
from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from operators import EndpointError
from tests.emulators.ur_controller import CB3, Recipe, version_payload

RECIPE = Recipe(7, tuple(OUTPUTS), tuple(OUTPUTS.values()))
ANSWERS = [
    pack(Kind.PROTOCOL, b"\1"),
    pack(Kind.CONTROLLER, version_payload(CB3)),
    pack(Kind.OUTPUTS, RECIPE.answer),
    pack(Kind.START, b"\1"),
]
DATA = [RECIPE.pack((k / 125, (k, 0, 0, 0, 0, 0), (0.0,) * 6)) for k in range(3)]


def fed(pieces: list[bytes]) -> tuple[bytes, str, RtdeClient]:
    """Return the payloads that a client receives from pieces of a byte stream, and why it fails."""

    async def main() -> tuple[bytes, str, RtdeClient]:
        reader, received = asyncio.StreamReader(), b""
        client = RtdeClient(LoopClock(), "127.0.0.1", 1, OUTPUTS, 125.0)

        async def feed() -> None:
            for piece in pieces:
                reader.feed_data(piece)
                await asyncio.sleep(0)
            reader.feed_eof()

        async def connected(*_: object) -> tuple[asyncio.StreamReader, MagicMock]:
            return reader, MagicMock()

        feeding = asyncio.create_task(feed())
        try:
            with patch("asyncio.open_connection", connected):
                await client.connect()
            while True:
                received += (await client.receive())[1].tobytes()
        except EndpointError as error:
            await feeding
            return received, error.reason, client

    return run_virtually(main())


@given(st.lists(st.integers(0, 700), max_size=20))
def test_any_cut_of_a_connection_gives_the_same_data(cuts: list[int]) -> None:
    stream = b"".join([*ANSWERS, *(pack(Kind.DATA, payload) for payload in DATA)])
    places = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    received, reason, _ = fed([stream[start:stop] for start, stop in pairwise(places)])
    assert (received, reason) == (b"".join(DATA), "the controller closed the connection")


@given(st.binary(max_size=2000))
def test_rubbish_is_an_error(data: bytes) -> None:
    kinds = Kind.PROTOCOL, Kind.CONTROLLER, Kind.OUTPUTS, Kind.START, Kind.DATA
    rubbish = [data, *(b"".join([*ANSWERS[:k], pack(kind, data)]) for k, kind in enumerate(kinds))]
    for sent in rubbish:
        received, reason, _ = fed([sent])
        assert (received, bool(reason)) == (b"", True)


@pytest.mark.parametrize(
    ("answers", "wrong", "reason"),
    [
        (0, pack(Kind.PROTOCOL, b"\0"), "does not support RTDE version 2"),
        (0, pack(Kind.CONTROLLER, version_payload(CB3)), "'v', expected 'V'"),
        (0, pack(Kind.DATA, DATA[0]), "'U', expected 'V'"),
        (1, pack(Kind.CONTROLLER, b"\1"), "version has 1 bytes"),
        (2, pack(Kind.OUTPUTS, b"\0DOUBLE,NOT_FOUND"), "actual_TCP_pose NOT_FOUND"),
        (2, pack(Kind.OUTPUTS, b"\1DOUBLE,VECTOR6D,VECTOR3D"), "DOUBLE, VECTOR6D, VECTOR3D as timestamp, "),
        (3, pack(Kind.START, b"\0"), "refused to start"),
        (3, pack(Kind.DATA, DATA[0]), "'U', expected 'S'"),
        (4, pack(Kind.DATA, DATA[0][:-1]), "data of 104 bytes"),
        (4, pack(Kind.DATA, b"\1" + DATA[0][1:]), "recipe 01, not 105 for 07"),
        (4, pack(ord("P"), b"\1"), "'P', expected 'U'"),
        (4, b"HTTP/1.1 400 Bad Request", "package of 18516 bytes"),
    ],
)
def test_an_unexpected_package_fails_after_earlier_data(answers: int, wrong: bytes, reason: str) -> None:
    before = [*ANSWERS[:answers], *([pack(Kind.DATA, DATA[0])] if answers == 4 else [])]
    received, error, _ = fed([b"".join([*before, wrong])])
    assert reason in error
    assert ("is not an RTDE server" in error) == (answers < 2 and "support" not in reason)
    assert received == (DATA[0] if answers == 4 else b"")


@given(st.lists(st.binary(max_size=60), min_size=1, max_size=9), st.integers(1, 300))
def test_messages_of_the_controller_are_counted_and_a_few_are_logged(texts: list[bytes], often: int) -> None:
    flood = b"".join(pack(Kind.TEXT, payload) for payload in texts) * often
    with patch.object(rtde.log, "handle") as handle:
        received, _, client = fed([*ANSWERS, flood, pack(Kind.DATA, DATA[0]), flood])
    logged = [call.args[0].getMessage() for call in handle.call_args_list]
    assert (client.texts, received) == (2 * often * len(texts), DATA[0])
    assert len(logged) == min(client.texts, rtde.TEXTS)
    assert all(line.isprintable() for line in logged)
