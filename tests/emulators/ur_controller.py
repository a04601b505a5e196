"""Emulated UR controller: RTDE, script port and dashboard on TCP sockets, and faults on command.

Supported clients are `connectors.ur.ur_motion.UrMotion` and ur-rtde's `RTDEControlInterface`, whose RTDE
port is always 30004.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from struct import Struct
from time import time_ns
from types import MappingProxyType
from typing import Final, NamedTuple, Self, TypeAlias

from connectors.ur.rtde import PROTOCOL, Kind, pack
from operators.batch import Reals, s
from storage.background_task import BackgroundTask
from tests.emulators.ur_control_box import GREETING, INPUTS, OUTPUTS, ControlBox, Value, answer

E_SERIES: Final = (5, 11, 0, 1)
CB3: Final = (3, 15, 8, 1)
SCRIPT_LIMIT: Final = 1 << 20  # bytes of an uploaded script

Serve: TypeAlias = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class Ports(NamedTuple):
    """Ports of a controller; 0 for any free port."""

    rtde: int = 30004
    script: int = 30003
    dashboard: int = 29999


_FORMATS: Final = MappingProxyType({"UINT32": "I", "INT32": "i", "DOUBLE": "d", "VECTOR6D": "6d"})
_HEADER: Final = Struct(">HB")  # size and kind
_RATE: Final = Struct(">d")
_INPUTS: Final = ord("I")  # request that our client does not make: names -> uint8 number of the recipe, types

PORTS: Final = Ports()
ANYWHERE: Final = Ports(0, 0, 0)


def names(payload: bytes) -> tuple[str, ...]:
    """Parse names or types separated by commas; a trailing comma is allowed.

    >>> names(b"timestamp,actual_q,")
    ('timestamp', 'actual_q')
    """
    return tuple(name.strip() for name in payload.decode("ascii", "replace").split(",") if name.strip())


@dataclass(frozen=True)
class Recipe:
    """Fields of a data package, in order.

    >>> recipe = Recipe(1, ("timestamp", "actual_q"), ("DOUBLE", "VECTOR6D"))
    >>> recipe.unpack(recipe.pack((0.5, (1, 2, 3, 4, 5, 6))))["timestamp"]
    0.5
    """

    number: int  # 1..255
    names: tuple[str, ...]
    types: tuple[str, ...]

    @cached_property
    def row(self) -> Struct:
        """Layout of a package."""
        return Struct(">B" + "".join(_FORMATS[kind] for kind in self.types))

    @property
    def answer(self) -> bytes:
        """Payload of the answer that grants the recipe."""
        return bytes([self.number]) + ",".join(self.types).encode()

    def pack(self, values: Sequence[Value]) -> bytes:
        """Pack values into a payload."""
        flat: list[float] = []
        for value in values:
            flat.extend(value if isinstance(value, tuple) else (value,))
        return self.row.pack(self.number, *flat)

    def unpack(self, payload: bytes) -> dict[str, float]:
        """Unpack the values of a payload by name; of a vector, the first one."""
        flat, found, begin = self.row.unpack(payload)[1:], dict[str, float](), 0
        for name, kind in zip(self.names, self.types, strict=True):
            found[name] = flat[begin]
            begin += int(_FORMATS[kind][:-1] or 1)
        return found


def version_payload(version: tuple[int, ...]) -> bytes:
    """Return the payload of the answer with a controller's version."""
    return Struct(">4I").pack(*version)


class UrController:
    """A controller that serves clients in an `async with` block.

    Cycles run on the clock `now` (ns); `drift` (s/s) is the rate error of the controller's own. The packages
    of a late cycle arrive late, as if delayed by the network. Inside the block, `ports` are the actual ones.
    """

    def __init__(
        self,
        pose: Reals,
        *,
        host: str = "127.0.0.1",
        ports: Ports = PORTS,
        version: tuple[int, ...] = E_SERIES,
        now: Callable[[], int] = time_ns,
        drift: float = 0.0,
    ) -> None:
        self.box, self.host, self.ports = ControlBox(pose, version), host, ports
        self.clients = list[RtdeConnection]()
        self._open = set[asyncio.StreamWriter]()  # connections to all ports
        self._now, self._period = now, s / self.box.rate / (1 + drift)  # ns
        self._servers: list[asyncio.Server] = []
        self._running: BackgroundTask | None = None
        self._origin = self._cycles = 0  # host time of power-up (ns), and cycles since

    async def __aenter__(self) -> Self:
        """Listen, and start the cycles."""
        rtde, script, dashboard = self.ports
        self._servers = [
            await self._listen(self._serve_rtde, rtde),
            await self._listen(self._run_scripts, script),
            await self._listen(self._answer_dashboard, dashboard),
        ]
        self.ports = Ports(*(each.sockets[0].getsockname()[1] for each in self._servers))
        self._origin, self._cycles = self._now(), 0
        self._running = BackgroundTask(self.host, "the arm", self._cycle())
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close all connections and stop listening; raise the error of an arm that failed."""
        for server in self._servers:
            server.close()
        self.drop()
        while self._open:  # noqa: ASYNC110 - they end at once
            await asyncio.sleep(0)
        if self._running:
            await self._running.end()
            self._running.check()

    def stall(self) -> None:
        """Send nothing more to the present clients of RTDE; the cycles go on."""
        for client in self.clients:
            client.stalled = True

    def drop(self) -> None:
        """Close all connections."""
        for writer in self._open:
            writer.transport.abort()

    def restart(self, *, drop: bool = True) -> None:
        """Power the controller down and up, which drops all clients unless `drop` is False."""
        if drop:
            self.drop()
        self.box.power_up()
        self._origin, self._cycles = self._now(), 0

    async def _listen(self, serve: Serve, port: int) -> asyncio.Server:
        async def serve_until_lost(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            self._open.add(writer)
            try:
                await serve(reader, writer)
            except (OSError, asyncio.IncompleteReadError):
                pass
            finally:
                self._open.discard(writer)
                writer.close()

        return await asyncio.start_server(serve_until_lost, self.host, port, limit=SCRIPT_LIMIT)

    async def _serve_rtde(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = RtdeConnection(self.box, writer.transport)
        self.clients.append(client)
        try:
            while True:
                size, kind = _HEADER.unpack(await reader.readexactly(_HEADER.size))
                client.handle(kind, await reader.readexactly(size - _HEADER.size))
        finally:
            self.clients.remove(client)

    async def _run_scripts(self, reader: asyncio.StreamReader, _: asyncio.StreamWriter) -> None:
        """Run programs, which end with a line ``end``."""
        while True:
            self.box.run_script((await reader.readuntil(b"\nend\n")).decode())

    async def _answer_dashboard(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(f"{GREETING}\n".encode())
        async for line in reader:
            writer.write(f"{answer(self.box, line.decode())}\n".encode())

    async def _cycle(self) -> None:
        while True:
            due = self._origin + round((self._cycles + 1) * self._period)
            lateness = self._now() - due
            if lateness < 0:
                await asyncio.sleep(-lateness / s)
                continue
            self._cycles += 1
            self.box.cycle()
            for client in self.clients:
                client.publish()
            if lateness > self._period:
                await asyncio.sleep(0)  # let other tasks run while it catches up


class RtdeConnection:
    """A client connection on the RTDE port; while it is `stalled`, nothing is sent."""

    def __init__(self, box: ControlBox, transport: asyncio.WriteTransport) -> None:
        self.box, self.transport, self.stalled = box, transport, False
        self._outputs: Recipe | None = None
        self._started, self._interval = False, 1  # cycles between packages
        self._inputs: dict[int, Recipe] = {}

    def publish(self) -> None:
        """Send the outputs of the latest cycle if they are due."""
        if self._started and self._outputs and self.box.cycles % self._interval == 0:
            values = self.box.values()
            self.send(Kind.DATA, self._outputs.pack([values[name] for name in self._outputs.names]))

    def send(self, kind: int, payload: bytes) -> None:
        """Send a package."""
        if not self.stalled and not self.transport.is_closing():
            self.transport.write(pack(kind, payload))

    def handle(self, kind: int, payload: bytes) -> None:
        """Handle a package."""
        match kind:
            case Kind.PROTOCOL:
                self.send(Kind.PROTOCOL, bytes([int.from_bytes(payload, "big") == PROTOCOL]))
            case Kind.CONTROLLER:
                self.send(Kind.CONTROLLER, version_payload(self.box.version))
            case Kind.OUTPUTS:
                self.send(Kind.OUTPUTS, self._grant_outputs(payload))
            case k if k == _INPUTS:
                self.send(_INPUTS, self._grant_inputs(names(payload)))
            case Kind.START:
                self._started = self._outputs is not None
                self.send(Kind.START, bytes([self._started]))
            case Kind.DATA:
                self.box.write(self._inputs[payload[0]].unpack(payload))
            case _:
                raise ConnectionAbortedError(f"unexpected package {chr(kind)!r}")

    def _grant_outputs(self, payload: bytes) -> bytes:
        [rate], wanted = _RATE.unpack_from(payload), names(payload[_RATE.size :])
        types = _types(wanted, OUTPUTS)
        if "NOT_FOUND" in types or not wanted or not 0 < rate <= self.box.rate:
            return b"\0" + ",".join(types).encode()
        self._outputs, self._interval = Recipe(1, wanted, types), round(self.box.rate / rate)
        return self._outputs.answer

    def _grant_inputs(self, wanted: tuple[str, ...]) -> bytes:
        number = len(self._inputs) + 1
        self._inputs[number] = Recipe(number, wanted, _types(wanted, INPUTS))
        return self._inputs[number].answer


def _types(wanted: tuple[str, ...], known: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(known.get(name, "NOT_FOUND") for name in wanted)
