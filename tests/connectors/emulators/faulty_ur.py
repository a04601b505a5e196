"""An emulated UR controller with faults on command."""

import socket
import struct
from collections import deque
from collections.abc import Callable
from time import time_ns
from typing import Final

from connectors.emulators.ur_control_box import Arm, ControlBox, RobotMode, SafetyMode
from connectors.emulators.ur_controller import E_SERIES, PORTS, Ports, UrController
from connectors.emulators.ur_ports import Connection, DashboardConnection, RtdeConnection, ScriptConnection
from connectors.ur.rtde import Kind, Version, pack

HELD: Final = 1 << 15  # packages, a minute; then the oldest are lost


def stop_in_emergency(box: ControlBox) -> None:
    """Press the emergency stop: the arm stops and loses its power, the program ends."""
    box.stop_program()
    box.drive.halt()
    box.safety_mode, box.robot_mode = SafetyMode.ROBOT_EMERGENCY_STOP, RobotMode.POWER_OFF


def release_emergency(box: ControlBox) -> None:
    """Release the emergency stop, and switch the arm on again."""
    box.safety_mode, box.robot_mode = SafetyMode.NORMAL, RobotMode.RUNNING


class FaultyRtdeConnection(RtdeConnection):
    """A client that can be held up, reset, or lost without a sign (`gone`)."""

    def __init__(self, box: ControlBox, connections: set[Connection], *, gone: bool = False) -> None:
        super().__init__(box, connections)
        self.held: deque[bytes] | None = None
        self.gone = gone

    def data_received(self, data: bytes) -> None:
        if not self.gone:
            super().data_received(data)

    def send(self, kind: Kind, payload: bytes) -> None:
        if self.held is not None:
            self.held.append(pack(kind, payload))
        elif not self.gone:
            super().send(kind, payload)

    def release(self, *, burst: bool) -> None:
        held, self.held = self.held or (), None
        if burst and not self.gone:
            self.transport.write(b"".join(held))

    def reset(self) -> None:
        linger = struct.pack("ii", 1, 0)  # close sends RST
        self.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        self.transport.abort()


class FaultyUrController(UrController):
    """A controller whose clock may be fast by `drift` (s/s)."""

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
        super().__init__(arm, host=host, ports=ports, version=version, now=now)
        self._period /= 1 + drift
        self._silent = False
        self.listeners = (self._connect, ScriptConnection, DashboardConnection)

    def _connect(self, box: ControlBox, connections: set[Connection]) -> FaultyRtdeConnection:
        return FaultyRtdeConnection(box, connections, gone=self._silent)

    @property
    def clients(self) -> list[FaultyRtdeConnection]:
        """Clients of RTDE."""
        return [each for each in self.connections if isinstance(each, FaultyRtdeConnection)]

    def stall(self) -> None:
        """Hold up all packages from now on; the cycles go on."""
        for client in self.clients:
            client.held = deque(client.held or (), HELD)

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
            for connection in list(self.connections):
                connection.transport.abort()
        self.box.power_up()
        self._origin, self._cycles = self._now(), 0
