"""Emulated UR controller: RTDE, script port and dashboard on TCP sockets, and faults on command.

Supported clients are `connectors.ur.ur_motion.UrMotion`, and ur-rtde's `RTDEReceiveInterface` and
`RTDEControlInterface`, whose RTDE port is always 30004.
"""

import asyncio
from collections.abc import Callable
from functools import partial
from time import time_ns
from typing import Final, NamedTuple, Self

from connectors.ur.rtde import Version
from operators.batch import s
from storage.background_task import BackgroundTask
from tests.emulators.ur_control_box import Arm, ControlBox, RobotMode, SafetyMode
from tests.emulators.ur_ports import Connection, DashboardConnection, RtdeConnection, ScriptConnection


class Ports(NamedTuple):
    """Ports of a controller; 0 for any free port."""

    rtde: int = 30004
    script: int = 30003
    dashboard: int = 29999


PORTS: Final = Ports()
ANYWHERE: Final = Ports(0, 0, 0)
E_SERIES: Final = Version(5, 11, 0, 1)
CB3: Final = Version(3, 15, 8, 1)


class UrController:
    """A controller that serves clients in an `async with` block.

    Cycles run on the clock `now`. A late cycle reports the arm at the instant when it was due; its packages
    arrive late, as if delayed by the network.

    Args:
        arm: Arm to control.
        host: Address on which to listen.
        ports: Ports on which to listen.
        version: Version of the software: 3.x runs at 125 Hz, 5.x at 500 Hz.
        now: Clock of the host (ns since 1970 UTC).
        drift: Rate error of the controller's clock, s/s.

    Attributes:
        box: The control box.
        ports: Actual ports inside the block.
        connections: Open connections.
    """

    def __init__(
        self,
        arm: Arm,
        *,
        host: str = "127.0.0.1",
        ports: Ports = PORTS,
        version: Version = E_SERIES,
        now: Callable[[], int] = time_ns,
        drift: float = 0.0,
    ) -> None:
        self.box, self.host, self.ports = ControlBox(arm, version), host, ports
        self.connections: set[Connection] = set()
        self._now, self._period = now, s / self.box.rate / (1 + drift)  # ns
        self._silent = False
        self._servers: list[asyncio.Server] = []
        self._running: BackgroundTask | None = None
        self._origin = self._cycles = 0  # host time of power-up (ns), and cycles since

    async def __aenter__(self) -> Self:
        """Listen, and start the cycles."""
        ports, loop = list[int](), asyncio.get_running_loop()
        listeners = self._connect_rtde, ScriptConnection, DashboardConnection
        for listener, port in zip(listeners, self.ports, strict=True):
            server = await loop.create_server(partial(listener, self.box, self.connections), self.host, port)
            self._servers.append(server)
            ports.append(server.sockets[0].getsockname()[1])
        self.ports = Ports(*ports)
        self._origin, self._cycles = self._now(), 0
        self._running = BackgroundTask(self.host, "the arm", self._cycle(), lambda _: self._drop())
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close all connections and stop listening; raise the error of an arm that failed."""
        for server in self._servers:
            server.close()
        for connection in list(self.connections):
            connection.transport.abort()
            await connection.lost.wait()
        if self._running:
            await self._running.end()
            self._running.check()

    @property
    def clients(self) -> list[RtdeConnection]:
        """Clients of RTDE."""
        return [each for each in self.connections if isinstance(each, RtdeConnection)]

    def stall(self) -> None:
        """Hold up all packages from now on; the cycles go on."""
        for client in self.clients:
            client.hold()

    def resume(self, *, burst: bool = False) -> None:
        """Send again, with a `burst` of the packages that were held up; else they are lost."""
        for client in self.clients:
            client.release(burst=burst)

    def reset(self) -> None:
        """Reset the connections of all clients of RTDE."""
        for client in self.clients:
            client.reset()

    def leave(self) -> None:
        """Become unreachable for the present clients of RTDE; new ones are served."""
        for client in self.clients:
            client.gone = True

    def silence(self) -> None:
        """Accept clients of RTDE from now on and never answer them."""
        self._silent = True

    def restart(self, *, drop: bool = True) -> None:
        """Power the controller down and up, which drops all clients unless `drop` is False."""
        if drop:
            self._drop()
        self.box.power_up()
        self._origin, self._cycles = self._now(), 0

    def stop_in_emergency(self) -> None:
        """Press the emergency stop: the arm stops and loses its power, the program ends."""
        self.box.stop_program()
        self.box.drive.halt()
        self.box.safety_mode, self.box.robot_mode = SafetyMode.ROBOT_EMERGENCY_STOP, RobotMode.POWER_OFF

    def release_emergency(self) -> None:
        """Release the emergency stop, and switch the arm on again."""
        self.box.safety_mode, self.box.robot_mode = SafetyMode.NORMAL, RobotMode.RUNNING

    def _connect_rtde(self, box: ControlBox, connections: set[Connection]) -> RtdeConnection:
        return RtdeConnection(box, connections, gone=self._silent)

    def _drop(self) -> None:
        """Close all connections."""
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
            for client in self.clients:
                client.publish()
            if lateness > self._period:
                await asyncio.sleep(0)  # let other tasks run while it catches up
