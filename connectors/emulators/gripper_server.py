"""Emulated Robotiq 3-Finger gripper: Modbus TCP server that applies the grip force to a scene."""

import asyncio
from collections.abc import Callable
from time import time_ns
from typing import TYPE_CHECKING, Final, Self

from connectors.emulators.gripper_mechanism import Mechanism, encode_status
from connectors.gripper.modbus_link import check_pymodbus
from connectors.gripper.robotiq import PORT, STATUS, UNIT, Request, octets, registers
from operators.checks import check_between
from operators.errors import EndpointError
from storage.background_task import BackgroundTask

if TYPE_CHECKING:
    from pymodbus.constants import ExcCodes
    from pymodbus.server import ModbusTcpServer

CYCLE: Final = 0.010  # s between updates of the mechanism
READ: Final = 4  # Modbus function: read input registers
WRITE: Final = 16  # Modbus function: write multiple registers
MAX_UNIT: Final = 255
IN_USE: Final = "cannot listen: end the program that uses the port, or give another address or port"


class GripperServer:
    """Gripper that serves clients in an `async with` block.

    Clients write the request from register 0 on (function 16) and read the status (function 4); other
    functions and other units are refused. Modbus has no authentication: if `host` is not a loopback address,
    any host can move the gripper.

    Args:
        mechanism: Emulated mechanism.
        host: Address on which to listen (default 127.0.0.1).
        port: Port on which to listen; 0 for any free one (default 502).
        unit: Modbus unit (default 2); 0 answers requests to any unit.
        now: Clock of the mechanism (ns since 1970 UTC).

    Attributes:
        port: Actual port inside the block.

    Raises:
        ParameterError: if the unit is not from 0 to 255.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        *,
        host: str = "127.0.0.1",
        port: int = PORT,
        unit: int = UNIT,
        now: Callable[[], int] = time_ns,
    ) -> None:
        check_between("GripperServer", "unit", unit, 0, MAX_UNIT)
        self.mechanism, self.host, self.port, self.unit = mechanism, host, port, unit
        self._now = now
        self._written = bytearray(2 * STATUS)
        self._server: ModbusTcpServer | None = None
        self._running: BackgroundTask | None = None

    async def __aenter__(self) -> Self:
        """Listen, and start the mechanism.

        Raises:
            EndpointError: if the port is in use.
            InputError: if pymodbus is not installed.
        """
        check_pymodbus("GripperServer")
        from pymodbus.server import ModbusTcpServer  # noqa: PLC0415 - an extra
        from pymodbus.simulator import DataType, SimData, SimDevice  # noqa: PLC0415 - an extra

        data = SimData(0, count=STATUS, datatype=DataType.REGISTERS)
        devices = [SimDevice(self.unit, data, action=self._answer)]
        if self.unit:
            devices.append(SimDevice(0, data, action=_refuse))
        server = ModbusTcpServer(devices, address=(self.host, self.port))
        try:
            await server.serve_forever(background=True)
        except RuntimeError as error:
            raise EndpointError(f"{self.host}:{self.port}", IN_USE) from error
        self._server = server
        if isinstance(server.transport, asyncio.Server):
            self.port = server.transport.sockets[0].getsockname()[1]
        self._running = BackgroundTask(f"{self.host}:{self.port}", "the gripper", self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close all connections and stop listening; raise the error of a gripper that failed."""
        running, self._running = self._running, None
        if running:
            await running.end()
        if self._server:
            self._server.close()
            await asyncio.sleep(0)  # lets the sockets close
        self._server = None
        if running:
            running.check()

    async def _run(self) -> None:
        while True:
            self.mechanism.advance(self._now())
            await asyncio.sleep(CYCLE)

    async def _answer(  # noqa: PLR0917 - as pymodbus calls it
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        current: list[int],
        written: "list[int] | list[bool] | None",
        /,
    ) -> "ExcCodes | None":
        """Execute a request; pymodbus sends the registers in `current` as the answer."""
        from pymodbus.constants import ExcCodes  # noqa: PLC0415 - an extra

        del start, count
        if function == WRITE and written is not None:
            data = octets(written)
            self._written[2 * address : 2 * address + len(data)] = data
            self.mechanism.request(Request.decode(bytes(self._written)), self._now())
        elif function == READ:
            current[:STATUS] = registers(encode_status(self.mechanism.status(self._now())))
        else:
            return ExcCodes.ILLEGAL_FUNCTION
        return None


async def _refuse(*request: object) -> "ExcCodes":
    """Refuse a request to another unit."""
    from pymodbus.constants import ExcCodes  # noqa: PLC0415 - an extra

    del request
    return ExcCodes.GATEWAY_NO_RESPONSE
