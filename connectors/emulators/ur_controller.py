"""A UR controller, emulated: RTDE, script port and dashboard over real sockets, driving an arm of the scene.

The real client libraries talk to it as they talk to an arm: `connectors.ur.ur_motion.UrMotion`, and ur-rtde's
`RTDEReceiveInterface` and `RTDEControlInterface`, which know one RTDE port only, 30004.
"""

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from time import time_ns
from types import TracebackType
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
from operators.errors import EndpointError, ParameterError, os_error_reason

CATCH_UP: Final = (
    1.0  # s of cycles that are made up for when the host held us up; of more, the rest is skipped
)

log = logging.getLogger("slipflow")


class Ports(NamedTuple):
    """Where a controller listens; 0 is any free port."""

    rtde: int = 30004
    script: int = 30003
    dashboard: int = 29999


PORTS: Final = Ports()
E_SERIES: Final = Version(5, 11, 0, 0)


class UrController:
    """A controller that serves its clients between `start` and `close`, or as a context.

    Its cycles run on the host's clock. A cycle that comes late, because the host was busy, still shows the
    arm at its due instant: its packages are late, as if held up on the way.

    Args:
        arm: What it drives and reports.
        host: The address that it listens on.
        ports: Its ports there.
        version: Of its software: 3.x runs at 125 Hz, 5.x at 500.
        now: The host's clock, ns since 1970 UTC.
        drift: By which its own clock is faster than the host's, s/s.

    Attributes:
        box: Its inside: protective and emergency stops, and whatever a program does.
        ports: Where it listens, once it does.

    Raises:
        ParameterError: on a drift that no clock has.
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
        if not -0.1 < drift < 0.1:  # noqa: PLR2004 - far beyond any crystal
            raise ParameterError("UrController", "drift", drift, "between -0.1 and 0.1 s/s")
        self.box, self.host, self.ports = ControlBox(arm, version), host, ports
        self._now, self._period = now, s / self.box.rate / (1 + drift)  # ns of the host's
        self._connections: set[Connection] = set()
        self._servers: list[asyncio.Server] = []
        self._running: asyncio.Task[None] | None = None
        self._began = self._cycles = 0  # ns of the host's when the clock was at 0, and cycles since
        self._silent = False

    async def start(self) -> None:
        """Listen, and run.

        Raises:
            EndpointError: if a port is taken.
        """
        listeners: list[Listener] = [RtdeConnection, ScriptConnection, DashboardConnection]
        ports: list[int] = []
        loop = asyncio.get_running_loop()
        for listener, port in zip(listeners, self.ports, strict=True):
            try:
                server = await loop.create_server(partial(self._accept, listener), self.host, port)
            except OSError as error:
                await self.close()  # nothing of it keeps listening
                raise EndpointError(
                    f"{self.host}:{port}", f"cannot be listened on: {os_error_reason(error)}"
                ) from error
            self._servers.append(server)
            ports.append(server.sockets[0].getsockname()[1])
        self.ports = Ports(*ports)
        self._began, self._cycles = self._now(), 0
        self._running = asyncio.create_task(self._run())

    async def close(self) -> None:
        """End all connections, and listen no more; raises what the arm raised, if it failed."""
        for server in self._servers:
            server.close()
        self._servers.clear()
        for connection in list(self._connections):
            connection.transport.abort()
            await connection.lost.wait()
        if self._running:
            self._running.cancel()
            with suppress(asyncio.CancelledError):
                await self._running

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    @property
    def clients(self) -> int:
        """Connections to any of its ports."""
        return len(self._connections)

    def stall(self) -> None:
        """Send nothing from now on, though the cycles go on."""
        for client in self._clients():
            client.hold()

    def resume(self, *, burst: bool = False) -> None:
        """Send again, with a `burst` of all that was held up; else that is lost."""
        for client in self._clients():
            client.release(burst=burst)

    def reset(self) -> None:
        """Reset the connections of all clients of RTDE."""
        for client in self._clients():
            client.reset()

    def leave(self) -> None:
        """Be out of reach for the present clients of RTDE, without a farewell; new ones are served."""
        for client in self._clients():
            client.gone = True

    def silence(self, *, silent: bool = True) -> None:
        """Accept clients of RTDE from now on and never answer them; or do so again."""
        self._silent = silent

    def restart(self, *, drop: bool = True) -> None:
        """Switch the controller off and on: its clock begins anew.

        Args:
            drop: All clients lose their connections, as they do; else the clock alone goes back.
        """
        if drop:
            for connection in list(self._connections):
                connection.transport.abort()
        self.box.restart()
        self._began, self._cycles = self._now(), 0

    def _clients(self) -> list[RtdeConnection]:
        return [each for each in self._connections if isinstance(each, RtdeConnection)]

    def _accept(self, kind: Listener) -> Connection:
        connection = kind(self.box, self._connections)
        if isinstance(connection, RtdeConnection):
            connection.gone = self._silent
        return connection

    async def _run(self) -> None:
        try:
            await self._cycle()
        except Exception:
            log.exception("the arm fails: the controller hangs up")
            for connection in list(self._connections):
                connection.transport.abort()
            raise

    async def _cycle(self) -> None:
        while True:
            due = self._began + round((self._cycles + 1) * self._period)
            if (wait := due - self._now()) > 0:
                await asyncio.sleep(wait / s)
                continue
            if -wait > CATCH_UP * s:
                skipped = int(-wait / self._period)
                log.warning("held up by the host: %d cycles are skipped", skipped)
                self.box.cycles += skipped
                self._cycles += skipped
                continue
            self._cycles += 1
            self.box.cycle(due)
            for client in self._clients():
                client.tell()
            if -wait > self._period:
                await asyncio.sleep(0)  # behind: clients must have their turn
