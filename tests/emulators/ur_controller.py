"""Emulated UR controller: RTDE, script port and dashboard on TCP sockets, and faults on command.

Supported clients are `connectors.ur.ur_motion.UrMotion`, and ur-rtde's `RTDEReceiveInterface` and
`RTDEControlInterface`, whose RTDE port is always 30004.
"""

import asyncio
import logging
import socket
import struct
from collections.abc import Callable, Mapping
from time import time_ns
from typing import Final, NamedTuple, Self, cast

from connectors.ur.rtde import PROTOCOL, Kind, RtdeError, Version, pack
from operators.batch import Reals, s
from storage.background_task import BackgroundTask
from tests.emulators.rtde_recipe import (
    Package,
    Packages,
    Recipe,
    Request,
    names,
    outputs_asked,
    version_payload,
)
from tests.emulators.ur_control_box import GREETING, INPUTS, OUTPUTS, ControlBox, answer

log = logging.getLogger("slipflow")

E_SERIES: Final = Version(5, 11, 0, 1)
CB3: Final = Version(3, 15, 8, 1)
SCRIPT_LIMIT: Final = 1 << 20  # bytes of an uploaded script


class Ports(NamedTuple):
    """Ports of a controller; 0 for any free port."""

    rtde: int = 30004
    script: int = 30003
    dashboard: int = 29999


PORTS: Final = Ports()
ANYWHERE: Final = Ports(0, 0, 0)


class UrController:
    """A controller that serves clients in an `async with` block.

    Cycles run on the clock `now`. The packages of a late cycle arrive late, as if delayed by the network.

    Args:
        pose: Initial pose of the arm, (6,) m and rotation vector.
        host: Address on which to listen.
        ports: Ports on which to listen.
        version: Version of the software: 3.x runs at 125 Hz, 5.x at 500 Hz.
        now: Clock of the host (ns since 1970 UTC).
        drift: Rate error of the controller's clock, s/s.

    Attributes:
        box: The control box.
        ports: Actual ports inside the block.
        clients: Clients of RTDE.
    """

    def __init__(
        self,
        pose: Reals,
        *,
        host: str = "127.0.0.1",
        ports: Ports = PORTS,
        version: Version = E_SERIES,
        now: Callable[[], int] = time_ns,
        drift: float = 0.0,
    ) -> None:
        self.box, self.host, self.ports = ControlBox(pose, version), host, ports
        self.clients = list[RtdeConnection]()
        self._texts = set[asyncio.StreamWriter]()  # of script port and dashboard
        self._now, self._period = now, s / self.box.rate / (1 + drift)  # ns
        self._servers: list[asyncio.Server] = []
        self._running: BackgroundTask | None = None
        self._origin = self._cycles = 0  # host time of power-up (ns), and cycles since

    async def __aenter__(self) -> Self:
        """Listen, and start the cycles."""
        loop, (rtde, script, dashboard) = asyncio.get_running_loop(), self.ports
        self._servers = [
            await loop.create_server(lambda: RtdeConnection(self.box, self.clients), self.host, rtde),
            await asyncio.start_server(self._run_scripts, self.host, script, limit=SCRIPT_LIMIT),
            await asyncio.start_server(self._answer_dashboard, self.host, dashboard),
        ]
        self.ports = Ports(*(each.sockets[0].getsockname()[1] for each in self._servers))
        self._origin, self._cycles = self._now(), 0
        self._running = BackgroundTask(self.host, "the arm", self._cycle())
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close all connections and stop listening; raise the error of an arm that failed."""
        for server in self._servers:
            server.close()
        clients = [*self.clients]
        self.drop()
        for client in clients:
            await client.lost.wait()
        if self._running:
            await self._running.end()
            self._running.check()

    def stall(self) -> None:
        """Send nothing more to the present clients of RTDE; the cycles go on."""
        for client in self.clients:
            client.stalled = True

    def reset(self) -> None:
        """Reset the connections of all clients of RTDE."""
        linger = struct.pack("ii", 1, 0)  # close sends RST
        for client in self.clients:
            connected = client.transport.get_extra_info("socket")
            connected.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
            client.transport.abort()

    def drop(self) -> None:
        """Close all connections."""
        for client in self.clients:
            client.transport.abort()
        for writer in self._texts:
            writer.transport.abort()

    def restart(self, *, drop: bool = True) -> None:
        """Power the controller down and up, which drops all clients unless `drop` is False."""
        if drop:
            self.drop()
        self.box.power_up()
        self._origin, self._cycles = self._now(), 0

    async def _run_scripts(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Run programs, which end with a line ``end``."""
        self._texts.add(writer)
        try:
            while True:
                self.box.run_script((await reader.readuntil(b"\nend\n")).decode())
        except (OSError, asyncio.IncompleteReadError):
            self._texts.discard(writer)
            writer.close()

    async def _answer_dashboard(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._texts.add(writer)
        writer.write(f"{GREETING}\n".encode())
        try:
            async for line in reader:
                writer.write(f"{answer(self.box, line.decode())}\n".encode())
        except OSError:
            pass
        self._texts.discard(writer)
        writer.close()

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


class RtdeConnection(asyncio.Protocol):
    """A client connection on the RTDE port.

    Args:
        box: The controller.
        clients: List that contains this connection while it is open.

    Attributes:
        stalled: Nothing is sent.
        lost: Event, set when the connection has ended.
    """

    def __init__(self, box: ControlBox, clients: "list[RtdeConnection]") -> None:
        self.box, self._clients, self.stalled, self.lost = box, clients, False, asyncio.Event()
        self._transport: asyncio.Transport | None = None
        self._packages, self._started = Packages(), False
        self._outputs: Recipe | None = None
        self._interval = 1  # cycles between packages
        self._inputs: dict[int, Recipe] = {}

    @property
    def transport(self) -> asyncio.Transport:
        """Transport of the socket, once connected."""
        assert self._transport
        return self._transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Add this connection to the open connections."""
        self._transport = cast("asyncio.Transport", transport)
        self._clients.append(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove this connection from the open connections."""
        del exc
        self._clients.remove(self)
        self.lost.set()

    def data_received(self, data: bytes) -> None:
        """Handle packages; disconnect a client that violates the protocol."""
        try:
            for package in self._packages.feed(data):
                self._handle(package)
        except RtdeError as error:
            log.warning("disconnecting an RTDE client: %s", error)
            self.transport.abort()

    def publish(self) -> None:
        """Send the outputs of the latest cycle if they are due."""
        if self._started and self._outputs and self.box.cycles % self._interval == 0:
            self.send(Kind.DATA, self._outputs.pack(self.box.values(self._outputs.names)))

    def send(self, kind: int, payload: bytes) -> None:
        """Send a package."""
        if not self.stalled and not self.transport.is_closing():
            self.transport.write(pack(kind, payload))

    def _handle(self, package: Package) -> None:
        kind, payload = package
        match kind:
            case Kind.PROTOCOL:
                self.send(Kind.PROTOCOL, bytes([int.from_bytes(payload, "big") == PROTOCOL]))
            case Kind.CONTROLLER:
                self.send(Kind.CONTROLLER, version_payload(self.box.version))
            case Kind.OUTPUTS:
                self.send(Kind.OUTPUTS, self._grant_outputs(payload))
            case Request.INPUTS:
                self.send(Request.INPUTS, self._grant_inputs(names(payload)))
            case Kind.START:
                self._started = self._outputs is not None
                self.send(Kind.START, bytes([self._started]))
            case Request.PAUSE:
                self._started = False
                self.send(Request.PAUSE, b"\1")
            case Kind.DATA if payload and payload[0] in self._inputs:
                recipe = self._inputs[payload[0]]
                self.box.write(dict(zip(recipe.names, recipe.unpack(payload), strict=True)))
            case Kind.TEXT:
                log.info("RTDE client: %r", payload[:255])
            case _:
                raise RtdeError(f"unexpected package {chr(kind)!r}")

    def _grant_outputs(self, payload: bytes) -> bytes:
        rate, wanted = outputs_asked(payload)
        types = _types(wanted, OUTPUTS)
        if "NOT_FOUND" in types or not wanted or not 0 < rate <= self.box.rate:
            return b"\0" + ",".join(types).encode()
        self._outputs, self._interval = Recipe(1, wanted, types), round(self.box.rate / rate)
        return self._outputs.answer

    def _grant_inputs(self, wanted: tuple[str, ...]) -> bytes:
        taken = {
            name: "IN_USE"
            for other in self._clients
            if other is not self
            for recipe in other._inputs.values()
            for name in recipe.names
        }
        types, number = _types(wanted, {**INPUTS, **taken}), len(self._inputs) + 1
        if {"NOT_FOUND", "IN_USE"} & set(types):
            return b"\0" + ",".join(types).encode()
        self._inputs[number] = Recipe(number, wanted, types)
        return self._inputs[number].answer


def _types(wanted: tuple[str, ...], known: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(known.get(name, "NOT_FOUND") for name in wanted)
