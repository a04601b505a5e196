"""Modbus TCP connection to a Robotiq gripper, through pymodbus."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from connectors.gripper.robotiq import PACE, SETTLE, STATUS, Request, Status
from operators.errors import EndpointError
from operators.extras import require_extra

if TYPE_CHECKING:
    from pymodbus.pdu import ModbusPDU

_DEVICE_FAILURE = 0x04
_REFUSALS = {
    0x01: "unknown function",
    0x02: "unknown registers: is it a 3-finger gripper?",
    0x03: "invalid value",
    _DEVICE_FAILURE: "device failure",
    0x06: "device busy",
    0x0A: "the gateway has no route to the device",
    0x0B: "no device answers: is this its unit?",
}


class GripperLink:
    """Connection for use until its first failure; then create another.

    Requests are sent one at a time, each `PACE` after the previous answer. In contrast to pymodbus, a lost
    connection is detected at once, requests are never retried, and refusals raise an error.

    Args:
        endpoint: Name of the gripper in messages.
        host: Address.
        port: Port.
        unit: Modbus unit.
        timeout: Longest wait for the connection, and for each answer, s.

    Raises:
        InputError: if pymodbus is not installed.
    """

    def __init__(self, endpoint: str, host: str, port: int, unit: int, timeout: float) -> None:
        require_extra("gripper", endpoint)
        from pymodbus.client import AsyncModbusTcpClient  # noqa: PLC0415 - an extra

        log = logging.getLogger("pymodbus.logging")
        if log.level == logging.NOTSET:
            log.setLevel(logging.CRITICAL)  # it duplicates the errors raised here

        self.endpoint, self._unit, self._timeout = endpoint, unit, timeout
        self._loop = asyncio.get_running_loop()
        self._lost: asyncio.Future[None] = self._loop.create_future()
        self._next = 0.0  # loop time (s) of the earliest next request
        self._settled = 0.0  # loop time (s) from which the status shows the newest request
        self._client = AsyncModbusTcpClient(
            host,
            port=port,
            name="gripper",
            reconnect_delay=0,  # never reconnect
            timeout=timeout,
            retries=0,
            trace_connect=self._changed,
        )

    async def connect(self) -> None:
        """Connect.

        Raises:
            EndpointError: if the gripper cannot be reached.
        """
        if not await self._client.connect():
            raise EndpointError(self.endpoint, "cannot be reached: is it on, is this its address and port?")

    async def wait_turn(self) -> None:
        """Wait until the next request may be sent."""
        await asyncio.sleep(self._next - self._loop.time())

    async def write(self, request: Request) -> None:
        """Write a request, and delay the next `read_status` by `SETTLE`, until the status shows it.

        Raises:
            EndpointError: if the connection is lost, or the gripper refuses or does not answer.
        """
        values = request.encode()
        await self._exchange(lambda: self._client.write_registers(0, values, device_id=self._unit))
        self._settled = self._loop.time() + SETTLE

    async def read_status(self) -> Status:
        """Read the status.

        Raises:
            EndpointError: if the connection is lost, or the gripper refuses, does not answer or sends an
                invalid status.
        """
        await asyncio.sleep(self._settled - self._loop.time())
        answer = await self._exchange(
            lambda: self._client.read_input_registers(0, count=STATUS, device_id=self._unit)
        )
        try:
            return Status.decode(answer.registers)
        except ValueError as error:
            raise EndpointError(self.endpoint, f"sends {error}: is it a 3-finger gripper?") from None

    def close(self) -> None:
        """Close the connection."""
        self._client.close()
        if not self._lost.done():
            self._lost.cancel()

    async def _exchange(self, request: "Callable[[], Awaitable[ModbusPDU]]") -> "ModbusPDU":
        """Wait for the turn, send a request and return the answer."""
        from pymodbus import ModbusException  # noqa: PLC0415 - an extra

        await self.wait_turn()
        if self._lost.done():  # pymodbus would reconnect silently
            raise EndpointError(self.endpoint, "the connection is lost")
        answering = asyncio.ensure_future(request())
        either: list[asyncio.Future[Any]] = [answering, self._lost]
        try:
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if not answering.done():
                raise EndpointError(self.endpoint, "the connection is lost")
            answer = answering.result()
        except ModbusException:
            raise EndpointError(
                self.endpoint, f"does not answer within {self._timeout} s: is {self._unit} its unit?"
            ) from None
        finally:
            answering.cancel()
            self._next = self._loop.time() + PACE
        if answer.isError():
            code = getattr(answer, "exception_code", _DEVICE_FAILURE)
            reason = _REFUSALS.get(code, f"Modbus exception {code}")
            raise EndpointError(self.endpoint, f"refuses: {reason}")
        return answer

    def _changed(self, connected: bool) -> None:  # noqa: FBT001 - as pymodbus calls it
        if not connected and not self._lost.done():
            self._lost.set_result(None)
