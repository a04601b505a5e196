"""One Modbus TCP connection to a Robotiq gripper: pymodbus' client with its traps closed."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from connectors.gripper.robotiq import PACE, SETTLE, STATUS, Request, RobotiqError, Status, octets, registers
from operators.errors import EndpointError, InputError

if TYPE_CHECKING:
    from pymodbus.pdu import ModbusPDU

_DEVICE_FAILURE = 0x04
_REFUSALS = {
    0x01: "it has no such function",
    0x02: "it has no such registers: is it a 3-finger gripper?",
    0x03: "it takes no such value",
    _DEVICE_FAILURE: "it failed",
    0x06: "it is busy",
    0x0A: "there is no way to it",
    0x0B: "nobody answers to this unit: which one is it set to?",
}


class GripperLink:
    """A connection for one use: once anything fails, close it and make another.

    Requests go out one at a time, each `PACE` after the answer to the one before. Beyond pymodbus it notices
    a lost connection at once, tries nothing a second time, and raises what the gripper refuses.

    Args:
        place: What the gripper is called in messages.
        host: Its address.
        port: Its port.
        unit: Its Modbus unit.
        patience: Seconds for the connection, and for each answer.

    Raises:
        InputError: if pymodbus is not installed.
    """

    def __init__(self, place: str, host: str, port: int, unit: int, patience: float) -> None:
        need_pymodbus(place)
        from pymodbus.client import AsyncModbusTcpClient  # noqa: PLC0415 - an extra

        self.place, self._unit, self._patience = place, unit, patience
        self._loop = asyncio.get_running_loop()
        self._lost: asyncio.Future[None] = self._loop.create_future()
        self._next = 0.0  # s of the loop, when the next request may go out
        self._settled = 0.0  # s of the loop, when the newest request shows in the status
        self._client = AsyncModbusTcpClient(
            host,
            port=port,
            name="gripper",
            reconnect_delay=0,  # never: whoever waits for it is to know
            timeout=patience,
            retries=0,
            trace_connect=self._changed,
        )

    async def connect(self) -> None:
        """Connect.

        Raises:
            EndpointError: if the gripper cannot be reached.
        """
        if not await self._client.connect():
            raise EndpointError(self.place, "cannot be reached: is it on, is this its address and port?")

    async def turn(self) -> None:
        """Wait until a request may go out."""
        await asyncio.sleep(self._next - self._loop.time())

    async def ask(self, request: Request) -> None:
        """Write a request; the status shows it `SETTLE` later at the earliest, and is not read before.

        Raises:
            EndpointError: if the connection is lost, or the gripper refuses or is silent.
        """
        values = registers(request.encode())
        await self._exchange(lambda: self._client.write_registers(0, values, device_id=self._unit))
        self._settled = self._loop.time() + SETTLE

    async def look(self) -> Status:
        """Read the status.

        Raises:
            EndpointError: if the connection is lost, or the gripper refuses, is silent or answers nonsense.
        """
        await asyncio.sleep(self._settled - self._loop.time())
        answer = await self._exchange(
            lambda: self._client.read_input_registers(0, count=STATUS, device_id=self._unit)
        )
        try:
            return Status.decode(octets(answer.registers))
        except RobotiqError as error:
            raise EndpointError(self.place, f"answers with {error}: is it a 3-finger gripper?") from None

    def close(self) -> None:
        """Let go of the connection."""
        self._client.close()
        if not self._lost.done():
            self._lost.cancel()

    async def _exchange(self, request: "Callable[[], Awaitable[ModbusPDU]]") -> "ModbusPDU":
        """Send a request when it is its turn, and wait for its answer."""
        from pymodbus import ModbusException  # noqa: PLC0415 - an extra

        await self.turn()
        if self._lost.done():  # pymodbus would connect by itself, and hide that
            raise EndpointError(self.place, "the connection is lost")
        asked = asyncio.ensure_future(request())
        either: list[asyncio.Future[Any]] = [asked, self._lost]
        try:
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if not asked.done():
                raise EndpointError(self.place, "the connection is lost")
            answer = asked.result()
        except ModbusException:
            raise EndpointError(
                self.place, f"does not answer within {self._patience} s: is {self._unit} its unit?"
            ) from None
        finally:
            asked.cancel()
            self._next = self._loop.time() + PACE
        if answer.isError():
            code = getattr(answer, "exception_code", _DEVICE_FAILURE)
            reason = _REFUSALS.get(code, f"Modbus exception {code}")
            raise EndpointError(self.place, f"refuses: {reason}")
        return answer

    def _changed(self, connected: bool) -> None:  # noqa: FBT001 - as pymodbus calls it
        if not connected and not self._lost.done():
            self._lost.set_result(None)


def need_pymodbus(owner: str) -> None:
    """Do nothing if pymodbus is installed; keep it from repeating in the log what our errors say.

    Raises:
        InputError: if it is not.
    """
    if find_spec("pymodbus") is None:
        raise InputError(owner, "needs pymodbus: in the clone, pip install -e '.[gripper]'")
    log = logging.getLogger("pymodbus.logging")
    if log.level == logging.NOTSET:
        log.setLevel(logging.CRITICAL)
