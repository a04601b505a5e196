"""Control of a Robotiq gripper over successive Modbus TCP connections: activation, requests and status."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Any, Final

from connectors.gripper.robotiq import PACE, SETTLE, STATUS, Request, Status
from operators.errors import EndpointError
from operators.extras import require_extra

if TYPE_CHECKING:
    from pymodbus.pdu import ModbusPDU

log = logging.getLogger("slipflow")
logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)  # it duplicates the errors raised here

ACTIVATION: Final = 30.0  # s, longest time until the gripper is ready
POLL: Final = 0.1  # s between two status requests
_DEVICE_FAILURE: Final = 0x04
_REFUSALS: Final = {
    0x01: "unknown function",
    0x02: "unknown registers: is it a 3-finger gripper?",
    0x03: "invalid value",
    _DEVICE_FAILURE: "device failure",
    0x06: "device busy",
    0x0A: "the gateway has no route to the device",
    0x0B: "no device answers: is this its unit?",
}


class GripperDrive:
    """Controller of a gripper.

    Requests are sent one at a time, each `PACE` after the previous answer. In contrast to pymodbus, a lost
    connection is detected at once, requests are never retried, and refusals raise an error. After an error
    the connection must be dropped.

    Args:
        endpoint: Name of the gripper in messages.
        address: Host and port.
        unit: Modbus unit.
        target: Request that sets the target; it is not sent before `go` is set.
        counted: Counters; ``sent`` and ``restarts`` are incremented.
        timeout: Longest wait for the connection, for each answer, and for the echo of a request, s.

    Attributes:
        target: Request that sets the target.
        status: Newest status after the newest request was echoed; None before the first of a connection.
        ready: True if the gripper accepts requests.
    """

    def __init__(
        self,
        endpoint: str,
        address: tuple[str, int],
        unit: int,
        target: Request,
        *,
        counted: dict[str, int],
        timeout: float,
    ) -> None:
        self.target = target
        self._endpoint, self._address, self._unit = endpoint, address, unit
        self._counted, self._timeout = counted, timeout
        self._changed = asyncio.Event()
        self._was_ready = False  # the gripper was ready when it last answered
        self._client: Any = None  # AsyncModbusTcpClient
        self._lost: asyncio.Future[None]  # done once the connection is lost
        self.drop()

    def drop(self) -> None:
        """Close the connection, if there is one."""
        if self._client:
            self._client.close()
            self._lost.cancel()
        self._client, self.ready = None, False
        self.status: Status | None = None
        self._sent: Request | None = None  # newest request of this connection
        self._next = 0.0  # loop time (s) of the earliest next request
        self._settled = 0.0  # loop time (s) from which the status shows the newest request
        self._due = -inf  # loop time (s) of the next status request
        self._requested = 0.0  # loop time (s) of the newest request whose echo is checked
        self._waiting = 0.0  # loop time (s), start of the wait for readiness

    @property
    def connected(self) -> bool:
        """True from `connect` to `drop`."""
        return self._client is not None

    @property
    def pending(self) -> bool:
        """True if the target has not been sent over this connection."""
        return self.target.go and self.target != self._sent

    def grip(self, force: int) -> None:
        """Set the force, as a register value."""
        self.target = replace(self.target, go=True, force=force)
        self._changed.set()

    async def connect(self) -> None:
        """Connect.

        Raises:
            EndpointError: if the gripper cannot be reached.
            InputError: if pymodbus is not installed.
        """
        require_extra("gripper", self._endpoint)
        from pymodbus.client import AsyncModbusTcpClient  # noqa: PLC0415 - an extra

        loop = asyncio.get_running_loop()
        self._lost, self._waiting = loop.create_future(), loop.time()
        host, port = self._address
        self._client = AsyncModbusTcpClient(
            host,
            port=port,
            name="gripper",
            reconnect_delay=0,  # never reconnect
            timeout=self._timeout,
            retries=0,
            trace_connect=self._trace_connection,
        )
        if not await self._client.connect():
            reason = "cannot be reached: is it on, is this its address and port?"
            raise EndpointError(self._endpoint, reason)

    async def start(self) -> None:
        """Connect, reset a fault, activate the gripper and send the target if it is set.

        Raises:
            EndpointError: if the gripper fails.
        """
        await self.connect()
        if (await self.read_status()).needs_reset:
            await self._write(Request())
        while not self.ready or self.pending:
            await self.step()

    async def step(self) -> None:
        """Connect, read the status or send the target if due, else wait until one of them is due.

        Raises:
            EndpointError: if the gripper fails.
        """
        if not self.connected:
            await self.connect()
        loop = asyncio.get_running_loop()
        now = loop.time()
        if now >= self._due:
            self._due = loop.time() + await self._check_status()
        elif self.ready and self.pending:
            await asyncio.sleep(self._next - now)
            await self._send(self.target)  # read after the wait, so it is the newest
        else:
            self._changed.clear()
            try:
                async with asyncio.timeout(self._due - now):
                    await self._changed.wait()
            except TimeoutError:
                pass

    async def read_status(self) -> Status:
        """Read the status.

        Raises:
            EndpointError: if the connection is lost, or the gripper refuses, does not answer or sends an
                invalid status.
        """
        await asyncio.sleep(self._settled - asyncio.get_running_loop().time())
        answer = await self._exchange(
            lambda: self._client.read_input_registers(0, count=STATUS, device_id=self._unit)
        )
        try:
            return Status.decode(answer.registers)
        except ValueError as error:
            raise EndpointError(self._endpoint, f"sends {error}: is it a 3-finger gripper?") from None

    async def _check_status(self) -> float:
        """Read the status, and activate the gripper if needed.

        Returns:
            Time until the next status request, s.
        """
        status, now = await self.read_status(), asyncio.get_running_loop().time()
        if status.needs_reset:
            raise EndpointError(self._endpoint, status.reason)
        if status.active and self._sent and status.echo != self._sent.position:
            if now - self._requested > self._timeout:
                reason = f"does not accept a request within {self._timeout} s"
                raise EndpointError(self._endpoint, f"{reason}: does another program command it?")
            return 0.0
        self.status = status
        if status.ready:
            self.ready = self._was_ready = True
            return POLL
        if self._was_ready:
            log.warning("%s has restarted: activating it again", self._endpoint)
            self._counted["restarts"] += 1
            self.ready = self._was_ready = False
            self._sent, self._waiting = None, now
        if now - self._waiting > ACTIVATION:
            reason = f"is not ready within {ACTIVATION} s: does something obstruct its fingers?"
            raise EndpointError(self._endpoint, reason)
        if not status.active:
            await self._send(Request(active=True))
        return POLL

    async def _send(self, request: Request) -> None:
        await self._write(request)
        if self._sent is None or replace(self._sent, force=request.force) != request:
            self._requested = self._due = asyncio.get_running_loop().time()
        self._sent = request
        self._counted["sent"] += 1

    async def _write(self, request: Request) -> None:
        """Write a request, and delay the next `read_status` by `SETTLE`, until the status shows it."""
        values = request.encode()
        await self._exchange(lambda: self._client.write_registers(0, values, device_id=self._unit))
        self._settled = asyncio.get_running_loop().time() + SETTLE

    async def _exchange(self, request: "Callable[[], Awaitable[ModbusPDU]]") -> "ModbusPDU":
        """Wait for the turn, send a request and return the answer."""
        from pymodbus import ModbusException  # noqa: PLC0415 - an extra

        loop = asyncio.get_running_loop()
        await asyncio.sleep(self._next - loop.time())
        if self._lost.done():  # pymodbus would reconnect silently
            raise EndpointError(self._endpoint, "the connection is lost")
        answering = asyncio.ensure_future(request())
        either: list[asyncio.Future[Any]] = [answering, self._lost]
        try:
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if not answering.done():
                raise EndpointError(self._endpoint, "the connection is lost")
            answer = answering.result()
        except ModbusException:
            reason = f"does not answer within {self._timeout} s: is {self._unit} its unit?"
            raise EndpointError(self._endpoint, reason) from None
        finally:
            answering.cancel()
            self._next = loop.time() + PACE
        if answer.isError():
            code = getattr(answer, "exception_code", _DEVICE_FAILURE)
            reason = _REFUSALS.get(code, f"Modbus exception {code}")
            raise EndpointError(self._endpoint, f"refuses: {reason}")
        return answer

    def _trace_connection(self, connected: bool) -> None:  # noqa: FBT001 - as pymodbus calls it
        if not connected and not self._lost.done():
            self._lost.set_result(None)
