"""Connections to peers of our own making: what they should not send, too."""

import asyncio
import socket
from collections.abc import Callable
from math import inf, nan
from typing import NamedTuple

import pytest

from connectors import UrMotion
from connectors.ur import rtde_link
from connectors.ur.rtde import Kind, Packages, Recipe, Version, pack
from connectors.ur.rtde_link import RtdeLink
from connectors.ur.ur_motion import OUTPUTS, TYPES
from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from operators import EndpointError, Motion, ms, s

Answer = Callable[[int], bytes]  # to a package, by its kind

HOST = "127.0.0.1"
CB3, E_SERIES = Version(3, 15, 8, 1), Version(5, 11, 0, 1)


async def exhaust(source: UrMotion, clock: LoopClock) -> tuple[list[Motion], EndpointError]:
    """All that a connection gives, and why it ended."""
    taken = list[Motion]()
    try:
        async for batch in source.batches(clock):
            taken.append(batch)
    except EndpointError as error:
        return taken, error
    raise AssertionError


async def serve(answer: Answer) -> asyncio.Server:
    """A peer that answers each package so."""

    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        packages = Packages()
        while data := await reader.read(1000):
            for kind, _ in packages.feed(data):
                writer.write(answer(kind))
        writer.close()

    return await asyncio.start_server(talk, HOST, 0)


class Outcome(NamedTuple):
    taken: list[Motion]
    reason: str
    source: UrMotion


def against(answer: Answer, rate: float = 125.0) -> Outcome:
    """What a source takes of such a peer, and why it fails."""

    async def main() -> Outcome:
        async with await serve(answer) as server:
            source = UrMotion(HOST, rate, server.sockets[0].getsockname()[1])
            taken, error = await exhaust(source, LoopClock())
            await asyncio.sleep(0.1)  # virtual: the server's side ends, too
            return Outcome(taken, error.reason, source)

    return run_virtually(main())


def controller(*stamps: float, version: Version = E_SERIES, types: tuple[str, ...] = TYPES) -> Answer:
    """A controller that sends packages with these stamps as soon as it is started."""
    recipe = Recipe(3, OUTPUTS, types)
    zeros = [(0.0,) * 6 if kind == "VECTOR6D" else (0.0,) * 3 for kind in types[1:]]

    def answer(kind: int) -> bytes:
        if kind == Kind.CONTROLLER:
            return pack(kind, version.payload)
        if kind == Kind.OUTPUTS:
            return pack(kind, recipe.answer)
        data = [pack(Kind.DATA, recipe.pack((stamp, *zeros))) for stamp in stamps]
        return pack(kind, b"\1") + (b"".join(data) if kind == Kind.START else b"")

    return answer


def test_a_package_that_is_sent_again_is_dropped_and_counted() -> None:
    taken, reason, source = against(controller(0.008, 0.016, 0.016, 0.016, 0.024))
    assert [batch.device_time.tolist() for batch in taken] == [[8 * ms, 16 * ms, 24 * ms]]
    assert source.describe()["repeated"] == 2
    assert reason == "sends nothing for 1.0 s: does it run, and is the cable in?"


def test_rows_before_the_clock_went_back_are_given_though_they_came_with_those_after() -> None:
    taken, reason, _ = against(controller(7.0, 7.008, 0.008, 7.016))
    assert [batch.device_time.tolist() for batch in taken] == [[7 * s, 7 * s + 8 * ms]]
    assert "went back" in reason


@pytest.mark.parametrize("stamp", [nan, inf, -1.0, 1e300])
def test_a_stamp_that_no_clock_shows_is_not_taken(stamp: float) -> None:
    taken, reason, _ = against(controller(0.008, stamp))
    assert not taken
    assert "stamps" in reason


def test_variables_of_another_type_are_not_taken() -> None:
    taken, reason, _ = against(controller(0.008, types=("DOUBLE", "VECTOR6D", "VECTOR3D")))
    assert not taken
    assert "VECTOR3D" in reason


def test_rubbish_is_not_taken_and_what_came_before_it_is() -> None:
    sound = controller(0.008, 0.016)

    def then_rubbish(kind: int) -> bytes:
        return sound(kind) + (b"\0\0\0" if kind == Kind.START else b"")

    taken, reason, _ = against(then_rubbish)
    assert [len(batch) for batch in taken] == [2]
    assert reason == "a package of 0 bytes, must be 3 to 8192"
    taken, reason, _ = against(lambda _: b"HTTP/1.1 400 Bad Request\r\n\r\n")
    assert (taken, reason) == ([], "it does not speak RTDE: a package of 18516 bytes, must be 3 to 8192")


def test_an_old_controller_that_grants_more_than_it_has_is_not_believed() -> None:
    taken, reason, _ = against(controller(0.008, version=CB3), rate=500.0)
    assert not taken
    assert "125.0 Hz at most" in reason


def test_nobody_listening_fails() -> None:
    with socket.socket() as free:
        free.bind((HOST, 0))
        source = UrMotion(HOST, port=free.getsockname()[1])

        async def main() -> tuple[list[Motion], EndpointError]:
            return await exhaust(source, LoopClock())

        taken, error = run_virtually(main())
    assert not taken
    assert "refuses the connection: is this its address" in error.reason


class Reading(asyncio.Transport):
    """A transport that says whether it reads."""

    def __init__(self) -> None:
        super().__init__()
        self.reads = True

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Take the requests."""

    def pause_reading(self) -> None:
        """Read no more."""
        self.reads = False

    def resume_reading(self) -> None:
        """Read again."""
        self.reads = True


def test_what_waits_is_bounded_by_not_reading_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rtde_link, "BACKLOG", 20)
    answer, recipe = controller(), Recipe(3, OUTPUTS, TYPES)

    async def main() -> None:
        link, transport = RtdeLink(LoopClock(), OUTPUTS, 125.0), Reading()
        link.connection_made(transport)
        link.data_received(b"".join(map(answer, (Kind.PROTOCOL, Kind.CONTROLLER, Kind.OUTPUTS, Kind.START))))
        for number in range(20):
            assert transport.reads
            link.data_received(pack(Kind.DATA, recipe.pack((number / 125, (0.0,) * 6, (0.0,) * 6))))
        assert not transport.reads
        arrivals, packages = await link.take()
        assert len(arrivals) == 20
        assert len(packages) == 20 * recipe.size
        assert transport.reads

    run_virtually(main())


def test_the_socket_does_not_wait_to_fill_its_segments() -> None:
    async def main() -> int:
        async with await serve(controller(0.008)) as server:
            link, loop = RtdeLink(LoopClock(), OUTPUTS, 125.0), asyncio.get_running_loop()
            transport, _ = await loop.create_connection(lambda: link, *server.sockets[0].getsockname())
            await link.take()
            option: int = transport.get_extra_info("socket").getsockopt(
                socket.IPPROTO_TCP, socket.TCP_NODELAY
            )
            await link.close()
            return option

    assert run_virtually(main())
