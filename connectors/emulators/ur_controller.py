"""Emulated UR controller: RTDE, script port and dashboard on TCP sockets.

Supported clients are `connectors.ur.ur_motion.UrMotion`, and ur-rtde's `RTDEReceiveInterface` and
`RTDEControlInterface`, whose RTDE port is always 30004.
"""

import asyncio
from collections.abc import Callable
from functools import partial
from time import time_ns
from typing import Final, NamedTuple, Self

from connectors.emulators.ur_control_box import Arm, ControlBox
from connectors.emulators.ur_ports import (
    Connection,
    DashboardConnection,
    Listener,
    RtdeConnection,
    ScriptConnection,
)
from connectors.ur.rtde import Version
from operators.batch import s
from operators.errors import EndpointError, os_error_reason
from storage.background_task import BackgroundTask


class Ports(NamedTuple):
    """Ports of a controller; 0 for any free port."""

    rtde: int = 30004
    script: int = 30003
    dashboard: int = 29999


PORTS: Final = Ports()
E_SERIES: Final = Version(5, 11, 0, 0)


class UrController:
    """A controller that serves clients in an `async with` block.

    Cycles run on the clock `now`. A late cycle reports the arm at the instant when it was due; its packages
    arrive late, as if delayed by the network.

    Args:
        arm: Arm to control.
        host: Address on which to listen (default 127.0.0.1).
        ports: Ports on which to listen.
        version: Version of the software: 3.x runs at 125 Hz, 5.x (default) at 500 Hz.
        now: Clock of the host (ns since 1970 UTC).

    Attributes:
        box: The control box.
        ports: Actual ports inside the block.
    """

    def __init__(
        self,
        arm: Arm,
        *,
        host: str = "127.0.0.1",
        ports: Ports = PORTS,
        version: Version = E_SERIES,
        now: Callable[[], int] = time_ns,
    ) -> None:
        self.box, self.host, self.ports = ControlBox(arm, version), host, ports
        self.listeners: tuple[Listener, ...] = (RtdeConnection, ScriptConnection, DashboardConnection)
        self.connections: set[Connection] = set()
        self._now, self._period = now, s / self.box.rate  # ns
        self._servers: list[asyncio.Server] = []
        self._running: BackgroundTask | None = None
        self._origin = self._cycles = 0  # host time of power-up (ns), and cycles since

    @property
    def command_overdue(self) -> bool:
        """True while a connected client is late with a command of its program, see `ControlBox`."""
        clients = (each for each in self.connections if isinstance(each, RtdeConnection))
        return self.box.command_overdue and any(client.inputs for client in clients)

    async def __aenter__(self) -> Self:
        """Listen, and start the cycles.

        Raises:
            EndpointError: if a port is in use.
        """
        ports: list[int] = []
        loop = asyncio.get_running_loop()
        for listener, port in zip(self.listeners, self.ports, strict=True):
            try:
                accept = partial(listener, self.box, self.connections)
                server = await loop.create_server(accept, self.host, port)
            except OSError as error:
                await self._close()
                reason = f"cannot listen: {os_error_reason(error)}"
                raise EndpointError(f"{self.host}:{port}", reason) from error
            self._servers.append(server)
            ports.append(server.sockets[0].getsockname()[1])
        self.ports = Ports(*ports)
        self._origin, self._cycles = self._now(), 0
        self._running = BackgroundTask(self.host, "the arm", self._cycle(), self._abort)
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close all connections and stop listening; raise the error of an arm that failed."""
        await self._close()
        if self._running:
            self._running.check()

    async def _close(self) -> None:
        for server in self._servers:
            server.close()
        self._servers.clear()
        for connection in list(self.connections):
            connection.transport.abort()
            await connection.lost.wait()
        if self._running:
            await self._running.end()

    def _abort(self, reason: str) -> None:
        """Close all connections, so that clients notice that the arm has failed."""
        del reason
        for connection in list(self.connections):
            connection.transport.abort()

    async def _cycle(self) -> None:
        while True:
            due = self._origin + round((self._cycles + 1) * self._period)
            lateness = self._now() - due
            if lateness < 0:
                await asyncio.sleep(-lateness / s)
                continue
            self._cycles += 1
            self.box.cycle(due)
            for client in list(self.connections):
                if isinstance(client, RtdeConnection):
                    client.publish()
            if lateness > self._period:
                await asyncio.sleep(0)  # let other tasks run while it catches up
