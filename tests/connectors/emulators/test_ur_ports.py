import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

import numpy as np
import pytest

from connectors.emulators.ur_controller import Ports, UrController
from connectors.ur.rtde import Kind, Package, Packages, Recipe, Version, ask_outputs, names, pack
from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from operators import s
from tests.connectors.emulators.free_arm import FreeArm

HOST = "127.0.0.1"
ANYWHERE = Ports(0, 0, 0)
E_SERIES = Version(5, 11, 0, 1)


class Client:
    """A client of RTDE, byte by byte."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self._packages, self._read = Packages(), list[Package]()

    def send(self, kind: Kind, payload: bytes = b"") -> None:
        """Send a package."""
        self.writer.write(pack(kind, payload))

    async def next(self) -> Package:
        """The next package; EOFError when the controller hung up."""
        while not self._read:
            if not (data := await self.reader.read(4096)):
                raise EOFError
            self._read += self._packages.feed(data)
        return self._read.pop(0)

    async def ask(self, kind: Kind, payload: bytes = b"") -> bytes:
        """Ask, and give the answer."""
        self.send(kind, payload)
        answer = await self.next()
        assert answer.kind == kind
        return answer.payload

    async def subscribe(self, rate: float, *outputs: str) -> Recipe:
        """Ask for outputs and start."""
        recipe = Recipe.granted(outputs, await self.ask(Kind.OUTPUTS, ask_outputs(rate, outputs)))
        assert await self.ask(Kind.START) == b"\1"
        return recipe


class Here:
    """A controller on the event loop's time, and its clients."""

    def __init__(self, controller: UrController) -> None:
        self.controller, self.box = controller, controller.box
        self._writers = list[asyncio.StreamWriter]()

    async def connect(self, port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """A connection to one of its ports."""
        reader, writer = await asyncio.open_connection(HOST, port)
        self._writers.append(writer)
        return reader, writer

    async def client(self) -> Client:
        """A client of RTDE."""
        return Client(*await self.connect(self.controller.ports.rtde))

    async def close(self) -> None:
        """Hang up."""
        for writer in self._writers:
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()


def virtually(body: Callable[[Here], Awaitable[None]]) -> None:
    """Do something with a controller in virtual time."""

    async def main() -> None:
        now = LoopClock(1_700_000_000 * s).now
        async with UrController(
            FreeArm(np.zeros(6)), host=HOST, ports=ANYWHERE, version=E_SERIES, now=now
        ) as controller:
            here = Here(controller)
            try:
                await body(here)
            finally:
                await here.close()

    run_virtually(main())


# --- RTDE ------------------------------------------------------------------------------------------------


def test_the_handshake_is_answered_as_the_guide_has_it() -> None:
    async def body(here: Here) -> None:
        client = await here.client()
        assert await client.ask(Kind.PROTOCOL, b"\0\1") == b"\0"
        assert await client.ask(Kind.PROTOCOL, b"\0\2") == b"\1"
        assert await client.ask(Kind.CONTROLLER) == E_SERIES.payload
        assert await client.ask(Kind.START) == b"\0"  # there is nothing to send yet
        asked = ask_outputs(500.0, ("timestamp", "robot_mode", ""))
        assert await client.ask(Kind.OUTPUTS, asked) == b"\1DOUBLE,INT32"
        assert await client.ask(Kind.START) == b"\1"
        kind, payload = await client.next()
        assert (chr(kind), payload[0], payload[9:].hex()) == ("U", 1, "00000007")
        client.send(Kind.PAUSE)
        while (answer := await client.next()).kind == Kind.DATA:
            pass
        assert answer == Package(Kind.PAUSE, b"\1")

    virtually(body)


@pytest.mark.parametrize(("rate", "every"), [(500.0, 1), (125.0, 4), (100.0, 5)])
def test_outputs_come_at_the_rate_that_was_asked_for(rate: float, every: int) -> None:
    async def body(here: Here) -> None:
        client = await here.client()
        recipe = await client.subscribe(rate, "timestamp")
        stamps = np.array([recipe.unpack((await client.next()).payload)[0] for _ in range(50)])
        np.testing.assert_allclose(np.diff(stamps), every / 500)

    virtually(body)


@pytest.mark.parametrize(
    ("rate", "asked", "answered"),
    [
        (500.0, ("timestamp", "nonsense"), b"\0DOUBLE,NOT_FOUND"),
        (501.0, ("timestamp",), b"\0DOUBLE"),
        (0.0, ("timestamp",), b"\0DOUBLE"),
        (500.0, (), b"\0"),
    ],
)
def test_outputs_that_it_does_not_have_are_refused(
    rate: float, asked: tuple[str, ...], answered: bytes
) -> None:
    async def body(here: Here) -> None:
        client = await here.client()
        assert await client.ask(Kind.OUTPUTS, ask_outputs(rate, asked)) == answered

    virtually(body)


def test_inputs_belong_to_one_client_until_it_leaves() -> None:
    async def body(here: Here) -> None:
        first, second = await here.client(), await here.client()
        asked = b"input_int_register_0,input_double_register_3,"
        assert await first.ask(Kind.INPUTS, asked) == b"\1INT32,DOUBLE"
        assert await first.ask(Kind.INPUTS, asked) == b"\2INT32,DOUBLE"
        assert await second.ask(Kind.INPUTS, asked) == b"\0IN_USE,IN_USE"
        assert await second.ask(Kind.INPUTS, b"input_int_register_9,pi") == b"\0INT32,NOT_FOUND"
        recipe = Recipe(2, names(asked), ("INT32", "DOUBLE"))
        first.send(Kind.DATA, recipe.pack((47, 0.5)))
        assert await first.ask(Kind.CONTROLLER)  # so the data has been taken
        assert here.box.registers.input_int[0] == 47
        assert here.box.registers.input_double[3] == 0.5
        first.writer.close()
        await asyncio.sleep(0.1)
        assert await second.ask(Kind.INPUTS, asked) == b"\1INT32,DOUBLE"

    virtually(body)


@pytest.mark.parametrize(
    "rubbish", [b"\0\0\0", pack(ord("X")), pack(Kind.DATA, b"\7"), pack(Kind.DATA), pack(Kind.OUTPUTS, b"")]
)
def test_who_does_not_keep_to_the_protocol_is_dropped(
    rubbish: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    async def body(here: Here) -> None:
        client = await here.client()
        client.writer.write(rubbish)
        with pytest.raises((EOFError, ConnectionResetError)):
            await client.next()
        assert await (await here.client()).ask(Kind.CONTROLLER)

    virtually(body)
    assert len(caplog.records) == 1


def test_who_does_not_read_is_dropped(caplog: pytest.LogCaptureFixture) -> None:
    async def body(here: Here) -> None:
        client = await here.client()
        everything = [f"output_double_register_{i}" for i in range(48)] * 4
        await client.subscribe(500.0, *everything)
        client.writer.transport.pause_reading()  # type: ignore[attr-defined]  # asyncio's sockets have it
        async with asyncio.timeout(60.0):
            while here.controller.connections:  # noqa: ASYNC110 - no event for it
                await asyncio.sleep(0.5)

    virtually(body)
    assert [record.message for record in caplog.records] == [
        "disconnecting an RTDE client that does not read"
    ]


# --- script port and dashboard ---------------------------------------------------------------------------


def test_a_program_runs_once_its_last_line_has_come_in_however_many_pieces() -> None:
    async def body(here: Here) -> None:
        _, writer = await here.connect(here.controller.ports.script)
        script = "def rtde_control():\n  if True:\n    x = read_input_integer_reg(0)\n  end\nend\n"
        for character in script:
            assert here.box.runtime_state == 1
            writer.write(character.encode())
            await asyncio.sleep(0.01)
        assert here.box.runtime_state == 2
        assert here.box.program == "rtde_control"

    virtually(body)


def test_the_dashboard_greets_and_answers_line_by_line() -> None:
    async def body(here: Here) -> None:
        reader, writer = await here.connect(here.controller.ports.dashboard)
        assert await reader.readline() == b"Connected: Universal Robots Dashboard Server\n"
        writer.write(b"robotmode\nsafety")
        assert await reader.readline() == b"Robotmode: RUNNING\n"
        writer.write(b"status\nquit\n")
        assert await reader.read() == b"Safetystatus: NORMAL\nDisconnected\n"

    virtually(body)


def test_text_without_an_end_is_not_kept(caplog: pytest.LogCaptureFixture) -> None:
    async def body(here: Here) -> None:
        reader, writer = await here.connect(here.controller.ports.dashboard)
        await reader.readline()
        writer.write(b"x" * 5000)
        await asyncio.sleep(0.1)
        assert not here.controller.connections

    virtually(body)
    assert "without a terminator" in caplog.text
