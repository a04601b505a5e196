"""Sink that sends force commands to a Robotiq 3-finger gripper over Modbus TCP."""

import asyncio
import logging
from collections.abc import AsyncGenerator
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from connectors.gripper.robotiq import (
    FULL,
    PACE,
    PORT,
    SETTLE,
    STATUS,
    STRONGEST,
    UNIT,
    WEAKEST,
    Request,
    Status,
    force_register,
)
from operators.batch import Commands
from operators.errors import EndpointError, ParameterError
from operators.ports import Clock, Finding, Run, Sink
from storage.background_task import BackgroundTask

if TYPE_CHECKING:
    from pymodbus.pdu import ModbusPDU

log = logging.getLogger("slipflow")
logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)  # it duplicates the errors raised here

ACTIVATION: Final = 30.0  # s, longest time until the gripper is ready
POLL: Final = 0.1  # s between two status requests
RETRY: Final = 1.0  # s between attempts to reconnect
TIMEOUT: Final = 1.0  # s for the connection, each answer, and the newest command at the end
_REFUSALS: Final = {
    0x02: "unknown registers: is it a 3-finger gripper?",
    0x04: "device failure",
    0x06: "device busy",
    0x0A: "the gateway has no route to the device",
    0x0B: "no device answers: is this its unit?",
}


@dataclass(eq=False)
class Gripper(Sink[Commands]):
    """Sink that sets the grip force of a Robotiq 3-finger gripper in its basic mode; the newest command wins.

    Opening activates an inactive gripper, which moves its fingers, and resets a fault. The fingers close with
    the first commanded force, and stop at an object. Closing the sink leaves them as they are.

    A command is executed on arrival, whatever its timestamp. A force of NaN has no effect; others are limited
    to 15 to 60 N. A lower force may not loosen the grip: according to the manual, stopped fingers move again
    only for a higher force or another position.

    A restarted gripper is activated and grips again. A gripper that fails (silent, lost, or with a fault) is
    tried again every second; meanwhile `write` raises, and the newest command is sent afterwards. Faults that
    need a reset are left to the user during a run.

    Source: Robotiq, "3-Finger Adaptive Robot Gripper Instruction Manual".

    Args:
        host: Address of the gripper.
        unit: Modbus unit id; 0 or 9 with some adapters.

    Attributes:
        status: Newest status; None while the gripper cannot be reached.

    Raises:
        ParameterError: on an invalid value.

    >>> Gripper("10.0.0.3").destination
    'modbus://10.0.0.3:502/2'
    """

    host: str
    port: int = PORT
    unit: int = UNIT

    extra = "gripper"
    lossless = False  # only the newest command matters
    live_only = True

    def __post_init__(self) -> None:
        if not self.host:
            raise ParameterError("Gripper", "host", self.host, "the address of a gripper")
        for name, highest in (("port", 65535), ("unit", FULL)):
            if not (isinstance(value := getattr(self, name), int) and 0 <= value <= highest):
                raise ParameterError("Gripper", name, value, f"a whole number from 0 to {highest}")
        self._serving: BackgroundTask | None = None  # None: not open
        self._reset()

    def _reset(self) -> None:
        """Set the state before a run; times are those of the event loop, s."""
        self._target = Request(active=True)
        self._client: Any = None  # AsyncModbusTcpClient
        self._changed = asyncio.Event()  # set with a new target
        self._failure = ""
        self._lose(0.0)

    def _lose(self, now: float) -> None:
        """Forget what is known of a gripper that failed, and begin to wait for its readiness."""
        self.status: Status | None = None
        self._sent: Request | None = None  # newest request
        self._due = 0.0  # next status request
        self._waiting = now

    @property
    def destination(self) -> str:
        """Address and unit of the gripper."""
        return f"modbus://{self.host}:{self.port}/{self.unit}"

    async def diagnose(self, clock: Clock) -> AsyncGenerator[Finding]:
        """Read the status of the gripper, without activating it.

        Raises:
            EndpointError: if the gripper cannot be reached.
        """
        try:
            self._create_client()
            status = await self._read_status()
        finally:
            self._disconnect()
        if status.fault:
            text = f"{status.reason}: remove what obstructs it; the start of a run resets the fault"
            yield Finding(self.destination, text, "bad")
        elif not status.ready:
            text = "answers, not activated: the start of a run activates it, which moves its fingers"
            yield Finding(self.destination, text, "note")
        else:
            yield Finding(self.destination, "ready")

    async def open(self, run: Run) -> None:
        """Connect, and activate the gripper if needed.

        Raises:
            EndpointError: if the gripper cannot be reached or activated.
        """
        self._reset()
        self._waiting = asyncio.get_running_loop().time()
        try:
            self._create_client()
            if (await self._read_status()).needs_reset:
                await self._send(Request())
            while not self._ready:
                await self._step()
        except BaseException:
            self._disconnect()
            raise
        self._serving = BackgroundTask(self.destination, "the control of the gripper", self._serve())

    async def write(self, batch: Commands) -> None:
        """Send the newest force of a batch.

        Raises:
            EndpointError: while the gripper fails; the newest force is sent after it recovers.
        """
        if self._serving:
            self._serving.check()
        forces = batch.force[~np.isnan(batch.force)]
        if len(forces):
            force = min(max(float(forces[-1]), WEAKEST), STRONGEST)
            self._target = Request(active=True, force=force_register(force))
            self._changed.set()
        if self._failure:
            raise EndpointError(self.destination, self._failure)

    async def close(self) -> None:
        """Send the newest command if it has not been sent, and disconnect; the fingers stay as they are.

        Raises:
            EndpointError: if the newest command cannot be sent, or the background task has failed.
        """
        if self._serving is None:
            return
        serving, self._serving = self._serving, None
        await serving.end()
        try:
            async with asyncio.timeout(TIMEOUT):
                while self._pending:
                    await self._step()
        except TimeoutError:
            raise EndpointError(self.destination, "is not ready for the newest command") from None
        finally:
            self._disconnect()
        serving.check()

    @property
    def _ready(self) -> bool:
        """True if the gripper accepts requests."""
        return self.status is not None and self.status.ready

    @property
    def _pending(self) -> bool:
        """True if a force is commanded that has not been sent."""
        return self._target.force is not None and self._target != self._sent

    async def _serve(self) -> None:
        """Keep the gripper on target until cancelled."""
        while True:
            try:
                await self._step()
            except EndpointError as error:
                self._lose(asyncio.get_running_loop().time())
                if not self._failure:
                    log.warning("%s, retrying", error)
                self._failure = error.reason
                await asyncio.sleep(RETRY)
            else:
                if self._ready and self._failure:
                    log.warning("%s works again", self.destination)
                    self._failure = ""

    async def _step(self) -> None:
        """Read the status or send the target if due, else wait until one of them is due."""
        loop = asyncio.get_running_loop()
        now = loop.time()
        if now >= self._due:
            await self._check_status()
            self._due = loop.time() + POLL
        elif self._ready and self._pending:
            await self._send(self._target)
        else:
            self._changed.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(self._due - now):
                    await self._changed.wait()

    async def _check_status(self) -> None:
        """Read the status, and activate the gripper if needed."""
        status, now = await self._read_status(), asyncio.get_running_loop().time()
        if status.needs_reset:
            raise EndpointError(self.destination, status.reason)
        if self._ready and not status.ready:
            log.warning("%s has restarted: activating it again", self.destination)
            self._lose(now)
        self.status = status
        if not status.ready and now - self._waiting > ACTIVATION:
            reason = f"is not ready within {ACTIVATION} s: does something obstruct its fingers?"
            raise EndpointError(self.destination, reason)
        if not status.active:
            await self._send(Request(active=True))

    async def _read_status(self) -> Status:
        """Read the status."""
        answer = await self._exchange("read_input_registers", count=STATUS)
        try:
            return Status.decode(answer.registers)
        except ValueError as error:
            raise EndpointError(self.destination, f"sends {error}: is it a 3-finger gripper?") from None

    async def _send(self, request: Request) -> None:
        """Send a request, and wait until the status shows it."""
        await self._exchange("write_registers", values=request.encode())
        self._sent = request
        await asyncio.sleep(SETTLE - PACE)

    async def _exchange(self, request: str, **values: Any) -> "ModbusPDU":
        """Connect if needed, send a request, return the answer when the next request may be sent."""
        from pymodbus import ModbusException

        if not self._client.connected and not await self._client.connect():
            reason = "cannot be reached: is it on, is this its address and port?"
            raise EndpointError(self.destination, reason)
        asked = getattr(self._client, request)(0, device_id=self.unit, **values)
        answering = asyncio.ensure_future(asked)  # a task, because its `wait_for` may lose a cancellation
        try:
            await asyncio.wait([answering])
            answer: ModbusPDU = answering.result()
        except ModbusException:
            reason = f"does not answer within {TIMEOUT} s: is {self.unit} its unit?"
            raise EndpointError(self.destination, reason) from None
        finally:
            answering.cancel()
        if answer.isError():
            reason = _REFUSALS.get(answer.exception_code, f"Modbus exception {answer.exception_code}")
            raise EndpointError(self.destination, f"refuses: {reason}")
        await asyncio.sleep(PACE)
        return answer

    def _create_client(self) -> None:
        """Create the client, which connects with the first request."""
        from pymodbus.client import AsyncModbusTcpClient

        self._client = AsyncModbusTcpClient(
            self.host, port=self.port, name="gripper", reconnect_delay=0, timeout=TIMEOUT, retries=0
        )

    def _disconnect(self) -> None:
        """Close the connection, if there is one."""
        if self._client:
            self._client.close()
        self._client, self.status = None, None
