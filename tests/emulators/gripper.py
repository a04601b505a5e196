"""Emulated Robotiq 3-Finger gripper: mechanism, Modbus server in memory, and faults on command.

The three fingers close as one at a constant speed and stop where they meet the object, which they grip with
the requested force from that instant on. They are self-locking: a larger force grips harder, a smaller one
changes nothing. An activation opens them. All durations are assumed, except the 10 ms until the status shows
a request. Only the basic mode is emulated.
"""

import asyncio
import struct
from collections import deque
from collections.abc import Callable
from enum import IntEnum
from typing import Any, Final, Self, cast

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from connectors.gripper.robotiq import FULL, SETTLE, STATUS, STRONGEST, UNIT, WEAKEST, Request
from operators.batch import s
from storage.background_task import BackgroundTask

HOST: Final = "__pymodbus_nullmodem"  # pymodbus' transport without sockets, for virtual time
PORT: Final = 5020
CLOSING: Final = 1.4  # s from open to closed
NOT_ACTIVATED: Final = 7  # fault
ACTIVATING: Final = 5  # fault
SCISSOR: Final = 137  # position of the scissor axis in the basic mode
RELEASED: Final = 0x0F  # fault: automatic release completed
CYCLE: Final = 0.010  # s between updates of the mechanism
READ: Final = 4  # Modbus function: read input registers
WRITE: Final = 16  # Modbus function: write multiple registers
MOVING, STOPPED = 0, 2  # motion of the fingers; stopped before the requested position


def register_force(register: int) -> float:
    """Return the force (N) of a register value."""
    return WEAKEST + register / FULL * (STRONGEST - WEAKEST)


class Phase(IntEnum):
    """State of the activation."""

    RESET = 0
    ACTIVATING = 1
    READY = 3


def asked(data: bytes) -> Request:
    """Return the request in the bytes from register 0 on; those after the sixth are for other modes."""
    return Request(bool(data[0] & 1), data[5] if data[0] & 1 << 3 else None)


class Mechanism:
    """Fingers, object and pending requests. Instants are in ns and never decrease.

    The fingers meet the object at the position `contact`, 0 to 255. An activation takes `activation` s.
    """

    def __init__(self, now: int, *, contact: int = 120, activation: float = 2.0) -> None:
        self.forces = list[float]()  # N, on the object, in order; 0: it was released
        self._contact, self._activation = contact, round(activation * s)
        self._time, self._position = now, 0.0
        self._pending = deque[tuple[int, Request]]()  # (time of effect in ns, request)
        self.power_up()

    def power_up(self) -> None:
        """Reset the registers; the fingers stay where they are."""
        self._asked, self._phase, self._fault, self._until = Request(), Phase.RESET, 0, 0
        self._pending.clear()

    def fail(self, fault: int) -> None:
        """Set a fault, one of `connectors.gripper.robotiq.FAULTS`, until it is reset."""
        self._phase, self._fault = Phase.RESET, fault

    def request(self, request: Request, now: int) -> None:
        """Accept a request; it takes effect after `SETTLE`."""
        self._pending.append((now + round(SETTLE * s), request))

    def advance(self, now: int) -> None:
        """Simulate up to an instant."""
        while self._pending and self._pending[0][0] <= now:
            time, request = self._pending.popleft()
            self._move(time)
            previous, self._asked = self._asked, request
            if not request.active:
                self._phase, self._fault = Phase.RESET, 0
            elif not previous.active:
                self._phase, self._until, self._position = Phase.ACTIVATING, time + self._activation, 0.0
                self._grip(0.0)
        self._move(now)

    def registers(self, now: int) -> bytes:
        """Return the 16 bytes of the status' registers at an instant; the motors report no current."""
        self.advance(now)
        closes, at = self._asked.force is not None, round(self._position)
        position = FULL if closes else 0  # requested
        if not self._asked.active:
            fault = NOT_ACTIVATED if closes else self._fault
            return bytes([self._phase << 4, 0, fault, position]) + bytes(12)
        go = closes and self._phase is Phase.READY
        fingers = MOVING
        if go and self.forces and self.forces[-1]:
            fingers = STOPPED
        axes = fingers * 0b010101 | 0b11000000 if go else 0
        fault = self._fault or (closes and self._phase is Phase.ACTIVATING) * ACTIVATING
        gripper = 1 | go << 3 | self._phase << 4 | fingers << 6
        return bytes([gripper, axes, fault, position, at, 0, 0, at, 0, 0, at, 0, 0, SCISSOR, 0, 0])

    def _move(self, until: int) -> None:
        elapsed, self._time = max(0, until - self._time), max(self._time, until)
        if self._phase is Phase.ACTIVATING and until >= self._until:
            self._phase = Phase.READY
        elif self._phase is Phase.READY and (force := self._asked.force) is not None:
            self._position = min(self._position + FULL / CLOSING * elapsed / s, self._contact)
            if self._position == self._contact < FULL:
                self._grip(max(register_force(force), *self.forces[-1:], 0.0))

    def _grip(self, force: float) -> None:
        if force != (self.forces[-1] if self.forces else 0.0):
            self.forces.append(force)


class GripperServer:
    """Gripper that serves clients in an `async with` block, and can refuse (`refusing`) or be `silent`.

    Clients write the request from register 0 on (function 16) and read the status (function 4); other
    functions are refused. `trace` is called with each packet, and whether it is sent, and
    returns the packet.
    """

    refusing = silent = False

    def __init__(self, *, now: Callable[[], int], **mechanism: Any) -> None:
        self.mechanism = Mechanism(now(), **mechanism)
        self.trace: Callable[[bool, bytes], bytes] = lambda _, data: data
        self._now, self._written = now, bytearray(2 * STATUS)
        self._server: ModbusTcpServer | None = None
        self._running: BackgroundTask | None = None

    async def __aenter__(self) -> Self:
        """Listen, and start the mechanism."""
        data = SimData(0, count=STATUS, datatype=DataType.REGISTERS)
        devices = [SimDevice(UNIT, data, action=self._answer)]
        server = ModbusTcpServer(devices, address=(HOST, PORT))
        server.trace_packet = self._pass_on
        await server.serve_forever(background=True)
        self._server = server
        self._running = BackgroundTask(HOST, "the gripper", self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close all connections and stop listening."""
        if self._running:
            await self._running.end()
        if self._server:
            self._server.close()
            await asyncio.sleep(0)  # lets the connections close
        self._server = None

    def restart(self, *, drop: bool = True) -> None:
        """Power it down and up: its registers are 0; with `drop` its clients lose their connections."""
        self.mechanism.advance(self._now())
        self.mechanism.power_up()
        self._written[:] = bytes(len(self._written))
        for client in list(self._server.active_connections.values()) if drop and self._server else []:
            cast("asyncio.Transport", client.transport).abort()

    async def _run(self) -> None:
        while True:
            self.mechanism.advance(self._now())
            await asyncio.sleep(CYCLE)

    async def _answer(
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        current: list[int],
        written: list[int] | list[bool] | None,
        /,
    ) -> ExcCodes | None:
        """Execute a request; pymodbus sends the registers in `current` as the answer."""
        if self.refusing:
            return ExcCodes.DEVICE_FAILURE
        if function == WRITE and written is not None:
            data = b"".join(int(value).to_bytes(2, "big") for value in written)
            self._written[2 * address : 2 * address + len(data)] = data
            self.mechanism.request(asked(bytes(self._written)), self._now())
        elif function == READ:
            current[:STATUS] = struct.unpack(f">{STATUS}H", self.mechanism.registers(self._now()))
        else:
            return ExcCodes.ILLEGAL_FUNCTION
        return None

    def _pass_on(self, sending: bool, data: bytes) -> bytes:
        return b"" if sending and self.silent else self.trace(sending, data)
