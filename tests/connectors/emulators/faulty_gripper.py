"""An emulated gripper with faults on command."""

import asyncio
import socket
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self, cast

from connectors.emulators.gripper_mechanism import ForceReceiver, Mechanism
from connectors.emulators.gripper_server import GripperServer
from connectors.gripper.robotiq import PORT, UNIT, Phase

RELEASED = 0x0F  # fault: automatic release completed

if TYPE_CHECKING:
    from pymodbus.constants import ExcCodes


def fail(mechanism: Mechanism, fault: int) -> None:
    """Set a fault, one of `connectors.gripper.robotiq.FAULTS`, until it is reset."""
    inside = cast("Any", mechanism)
    inside._phase, inside._until, inside._fault = Phase.RESET, None, fault


class FaultyGripperServer(GripperServer):
    """A gripper that can restart, drop its clients, refuse (`refusing`) or not answer (`silent`)."""

    refusing = silent = False

    def __init__(
        self,
        scene: ForceReceiver,
        *,
        now: Callable[[], int],
        host: str = "127.0.0.1",
        port: int = PORT,
        unit: int = UNIT,
        **mechanism: Any,  # noqa: ANN401 - those of a mechanism
    ) -> None:
        super().__init__(Mechanism(scene, now(), **mechanism), host=host, port=port, unit=unit, now=now)

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        assert self._server
        self._server.trace_packet = self._trace
        return self

    def restart(self, *, drop: bool = True) -> None:
        """Power it down and up: its registers are 0; with `drop` its clients lose their connections."""
        self.mechanism.advance(self._now())
        self.mechanism.power_up()
        self._written[:] = bytes(len(self._written))
        if drop:
            self.drop()

    def drop(self) -> None:
        """Reset the connections of all clients."""
        for client in list(self._server.active_connections.values()) if self._server else []:
            transport = cast("asyncio.Transport", client.transport)
            if connected := transport.get_extra_info("socket"):
                connected.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            transport.abort()

    async def _answer(self, *request: Any) -> "ExcCodes | None":  # noqa: ANN401 - as pymodbus calls it
        from pymodbus.constants import ExcCodes  # noqa: PLC0415 - an extra

        return ExcCodes.DEVICE_FAILURE if self.refusing else await super()._answer(*request)

    def _trace(self, sending: bool, data: bytes) -> bytes:  # noqa: FBT001 - as pymodbus calls it
        return b"" if sending and self.silent else data
