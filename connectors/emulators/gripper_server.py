"""A Robotiq 3-finger gripper, emulated: its registers over Modbus TCP, its fingers in the scene."""

import asyncio
import socket
import struct
from collections.abc import Callable
from contextlib import suppress
from time import time_ns
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self, cast

from connectors.emulators.gripper_mechanism import Gripped, Mechanism
from connectors.gripper.grip_force import ForceScale
from connectors.gripper.modbus_link import need_pymodbus
from connectors.gripper.robotiq import PORT, STATUS, UNIT, Request, octets, registers
from operators.errors import EndpointError, ParameterError

if TYPE_CHECKING:
    from pymodbus.constants import ExcCodes
    from pymodbus.server import ModbusTcpServer

CYCLE: Final = 0.010  # s
READ: Final = 4  # Modbus functions
WRITE: Final = 16
TAKEN: Final = "cannot be listened on: end the program that uses it, or give another address or port"


class GripperServer:
    """A gripper that serves its clients between `start` and `close`, or as a context.

    It takes what is written from register 0 on (function 16) and gives its status (function 4); it refuses
    other functions, and other units. Whoever listens beyond loopback lets everybody there move it.

    Args:
        scene: Is told of the grip force, such as a `Lab`.
        host: The address that it listens on.
        port: Its port there; 0: any free one.
        unit: Its Modbus unit; 0: it answers as any.
        now: The host's clock, ns since 1970 UTC; that of a lab is its `now`.
        met: Position, 0 to 255, at which the fingers meet an object; None: there is none.
        activation: Seconds that an activation takes.
        change: Seconds that a change of mode takes.
        scale: What the force register means.

    Attributes:
        mechanism: Its inside: faults and the object are commanded there.
        port: Where it listens, once it does.

    Raises:
        ParameterError: if there can be no such unit.
    """

    def __init__(
        self,
        scene: Gripped,
        *,
        host: str = "127.0.0.1",
        port: int = PORT,
        unit: int = UNIT,
        now: Callable[[], int] = time_ns,
        met: int | None = 120,
        activation: float = 2.0,
        change: float = 1.0,
        scale: ForceScale | None = None,
    ) -> None:
        if not 0 <= unit <= 255:  # noqa: PLR2004 - a byte
            raise ParameterError("GripperServer", "unit", unit, "from 0 to 255")
        self.host, self.port, self.unit = host, port, unit
        self.mechanism = Mechanism(scene, now(), met=met, activation=activation, change=change, scale=scale)
        self._now = now
        self._written = bytearray(2 * STATUS)
        self._refusing = self._silent = False
        self._server: ModbusTcpServer | None = None
        self._running: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Listen, and let time go by.

        Raises:
            EndpointError: if the port is taken.
            InputError: if pymodbus is not installed.
        """
        need_pymodbus("GripperServer")
        from pymodbus.server import ModbusTcpServer  # noqa: PLC0415 - an extra
        from pymodbus.simulator import DataType, SimData, SimDevice  # noqa: PLC0415 - an extra

        data = SimData(0, count=STATUS, datatype=DataType.REGISTERS)
        devices = [SimDevice(self.unit, data, action=self._act)]
        if self.unit:
            devices.append(SimDevice(0, data, action=_nobody))
        server = ModbusTcpServer(devices, address=(self.host, self.port), trace_packet=self._pass)
        try:
            await server.serve_forever(background=True)
        except RuntimeError as error:
            raise EndpointError(f"{self.host}:{self.port}", TAKEN) from error
        self._server = server
        if isinstance(server.transport, asyncio.Server):
            self.port = server.transport.sockets[0].getsockname()[1]
        self._running = asyncio.create_task(self._run())

    async def close(self) -> None:
        """End all connections, and listen no more."""
        if self._running:
            self._running.cancel()
            with suppress(asyncio.CancelledError):
                await self._running
        if self._server:
            self._server.close()
            await asyncio.sleep(0)  # until the sockets are closed
        self._server = self._running = None

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    def restart(self, *, drop: bool = True) -> None:
        """Switch it off and on: its registers are 0, and it must be activated again.

        Args:
            drop: All clients lose their connections.
        """
        self.mechanism.advance(self._now())
        self.mechanism.restart()
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

    def refuse(self, *, refusing: bool = True) -> None:
        """Answer every request from now on with a failure; or do as asked again."""
        self._refusing = refusing

    def silence(self, *, silent: bool = True) -> None:
        """Obey, but answer nothing from now on; or do so again."""
        self._silent = silent

    async def _run(self) -> None:
        while True:
            self.mechanism.advance(self._now())
            await asyncio.sleep(CYCLE)

    async def _act(  # noqa: PLR0917 - as pymodbus calls it
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        current: list[int],
        written: "list[int] | list[bool] | None",
    ) -> "ExcCodes | None":
        """Do what a client asks for; as pymodbus has it, the answer is read from `current`."""
        from pymodbus.constants import ExcCodes  # noqa: PLC0415 - an extra

        del start, count
        if self._refusing:
            return ExcCodes.DEVICE_FAILURE
        if function == WRITE and written is not None:
            data = octets(written)
            self._written[2 * address : 2 * address + len(data)] = data
            self.mechanism.ask(Request.decode(bytes(self._written)), self._now())
        elif function == READ:
            current[:STATUS] = registers(self.mechanism.look(self._now()).encode())
        else:
            return ExcCodes.ILLEGAL_FUNCTION
        return None

    def _pass(self, sending: bool, data: bytes) -> bytes:  # noqa: FBT001 - as pymodbus calls it
        return b"" if sending and self._silent else data


async def _nobody(*asked: object) -> "ExcCodes":
    """What becomes of a request to another unit."""
    from pymodbus.constants import ExcCodes  # noqa: PLC0415 - an extra

    del asked
    return ExcCodes.GATEWAY_NO_RESPONSE
