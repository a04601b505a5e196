"""Emulated Robotiq 3-Finger gripper: mechanism, Modbus TCP server, and faults on command.

The three fingers move as one at a constant speed and stop where they meet the object, which they grip with
the requested force from that instant on. They are self-locking: a larger force grips harder, a smaller one
changes nothing until they open. All durations are assumed, except the 10 ms until the status shows a request.
Only the basic mode is emulated.
"""

import asyncio
import socket
import struct
from collections import deque
from collections.abc import Callable
from typing import Any, Final, Protocol, Self, cast

import numpy as np
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from connectors.gripper.robotiq import (
    FULL,
    PORT,
    SETTLE,
    STATUS,
    UNIT,
    Fingers,
    Phase,
    Request,
    Status,
    register_force,
)
from operators.batch import Commands, s
from storage.background_task import BackgroundTask

SLOWEST: Final = 7.0  # s from open to closed at speed 0
FASTEST: Final = 1.4  # s from open to closed at full speed
NOT_ACTIVATED: Final = 7  # fault
ACTIVATING: Final = 5  # fault
SCISSOR: Final = 137  # position of the scissor axis in the basic mode
RELEASED: Final = 0x0F  # fault: automatic release completed
CYCLE: Final = 0.010  # s between updates of the mechanism
READ: Final = 4  # Modbus function: read input registers
WRITE: Final = 16  # Modbus function: write multiple registers


class ForceReceiver(Protocol):
    """Receiver of the grip force, such as a list of forces."""

    def command(self, commands: Commands) -> None:
        """Apply the grip force (N) from the commands' times on."""
        ...


class Mechanism:
    """Fingers, object and pending requests. Instants are in ns and never decrease.

    Args:
        scene: Receiver of each change of the grip force.
        now: Instant of power-up.
        contact: Position, 0 to 255, at which the fingers meet an object; None for no object.
        activation: Duration of an activation (s), during which the fingers open.

    Attributes:
        contact: Position of contact, as above; change it only while the fingers are open.
        force: Grip force on the object (N).
    """

    def __init__(
        self,
        scene: ForceReceiver,
        now: int,
        *,
        contact: int | None = 120,
        activation: float = 2.0,
    ) -> None:
        self.contact, self.force = contact, 0.0
        self._scene = scene
        self._activation = round(activation * s)
        self._time, self._position = now, 0.0
        self._pending = deque[tuple[int, Request]]()  # (time of effect in ns, request)
        self.power_up()

    def power_up(self) -> None:
        """Reset the registers; the fingers stay where they are."""
        self._current, self._phase, self._fault = Request(), Phase.RESET, 0
        self._until: int | None = None  # end of the activation
        self._pending.clear()

    def fail(self, fault: int) -> None:
        """Set a fault, one of `connectors.gripper.robotiq.FAULTS`, until it is reset."""
        self._phase, self._until, self._fault = Phase.RESET, None, fault

    def request(self, request: Request, now: int) -> None:
        """Accept a request; it takes effect after `SETTLE`."""
        self.advance(now)
        self._pending.append((now + round(SETTLE * s), request))

    def status(self, now: int) -> Status:
        """Return the status at an instant."""
        self.advance(now)
        request, position = self._current, round(self._position)
        if not request.active:
            return Status(echo=request.position, fault=NOT_ACTIVATED if request.go else self._fault)
        go = request.go and self._phase is Phase.READY
        early = request.go and self._phase is Phase.ACTIVATING
        return Status(
            active=True,
            go=go,
            phase=self._phase,
            fingers=self._fingers() if go else Fingers.MOVING,
            fault=self._fault or early * ACTIVATING,
            echo=request.position,
            positions=(position, position, position),
        )

    def advance(self, now: int) -> None:
        """Simulate up to an instant."""
        while True:
            effective = self._pending[0][0] if self._pending else now
            due = min(now, effective, now if self._until is None else self._until)
            self._move(due)
            if self._until is not None and self._until <= due:
                self._phase, self._until = Phase.READY, None
            elif self._pending and self._pending[0][0] <= due:
                self._start(self._pending.popleft()[1])
            else:
                return

    def _start(self, request: Request) -> None:
        """Begin to execute a request."""
        previous, self._current = self._current, request
        if not request.active:
            self._phase, self._until, self._fault = Phase.RESET, None, 0
        elif not previous.active:
            self._phase, self._until = Phase.ACTIVATING, self._time + self._activation

    def _target(self) -> tuple[int, float] | None:
        """Return target position and speed (positions per second); None if the fingers must not move."""
        if self._phase is Phase.ACTIVATING:
            return 0, FULL / FASTEST
        if self._phase is Phase.READY and self._current.go:
            fraction = self._current.speed / FULL
            return self._current.position, FULL / SLOWEST + fraction * (FULL / FASTEST - FULL / SLOWEST)
        return None

    def _move(self, until: int) -> None:
        """Move the fingers until an instant."""
        since, self._time = self._time, max(self._time, until)
        if (target := self._target()) is None:
            return
        goal, speed = target
        travel = speed * (self._time - since) / s
        if goal < self._position:
            self._grip(0.0, since)
            self._position = max(float(goal), self._position - travel)
            return
        contact = self.contact
        end = float(goal if contact is None or contact < self._position else min(goal, contact))
        distance = end - self._position
        self._position = end if distance <= travel else self._position + travel
        if distance <= travel and end < goal:
            force = max(self.force, register_force(self._current.force))
            self._grip(force, since + round(distance / speed * s))

    def _fingers(self) -> Fingers:
        if self._position == self._current.position:
            return Fingers.ARRIVED
        return Fingers.ALL_STOPPED if self.force else Fingers.MOVING

    def _grip(self, force: float, instant: int) -> None:
        """Grip with a force (N) from an instant on."""
        if force != self.force:
            self.force = force
            self._scene.command(Commands(np.array([instant]), np.array([force])))


def encode_status(status: Status) -> bytes:
    """Return the 16 bytes of a status' registers; the motors report no current."""
    if not status.active:
        return bytes([status.phase << 4, 0, status.fault, status.echo]) + bytes(12)
    gripper = status.active | status.go << 3 | status.phase << 4 | status.fingers << 6
    axes = int(status.fingers) * 0b010101 | 0b11000000 if status.go else 0
    a, b, c = status.positions
    return bytes([gripper, axes, status.fault, status.echo, a, 0, 0, b, 0, 0, c, 0, 0, SCISSOR, 0, 0])


def decode_request(data: bytes) -> Request:
    """Return the request in the bytes from register 0 on; those after the sixth are for other modes."""
    action, _, _, position, speed, force = data[:6]
    return Request(bool(action & 1), bool(action & 1 << 3), position, speed, force)


class GripperServer:
    """Gripper that serves clients in an `async with` block, and can refuse (`refusing`) or be `silent`.

    Clients write the request from register 0 on (function 16) and read the status (function 4); other
    functions and other units are refused.

    Args:
        scene: Receiver of the grip force.
        now: Clock of the mechanism (ns since 1970 UTC).
        host: Address on which to listen.
        port: Port on which to listen; 0 for any free one.
        unit: Modbus unit; 0 answers requests to any unit.
        mechanism: Arguments of the mechanism.

    Attributes:
        port: Actual port inside the block.
        trace: Called with each packet, and whether it is sent; returns the packet.
    """

    refusing = silent = False

    def __init__(
        self,
        scene: ForceReceiver,
        *,
        now: Callable[[], int],
        host: str = "127.0.0.1",
        port: int = PORT,
        unit: int = UNIT,
        **mechanism: Any,
    ) -> None:
        self.mechanism, self.host, self.port, self.unit = (
            Mechanism(scene, now(), **mechanism),
            host,
            port,
            unit,
        )
        self.trace: Callable[[bool, bytes], bytes] = lambda _, data: data
        self._now, self._written = now, bytearray(2 * STATUS)
        self._server: ModbusTcpServer | None = None
        self._running: BackgroundTask | None = None

    async def __aenter__(self) -> Self:
        """Listen, and start the mechanism."""
        data = SimData(0, count=STATUS, datatype=DataType.REGISTERS)
        devices = [SimDevice(self.unit, data, action=self._answer)]
        if self.unit:
            devices.append(SimDevice(0, data, action=_refuse))
        server = ModbusTcpServer(devices, address=(self.host, self.port))
        server.trace_packet = self._pass_on
        await server.serve_forever(background=True)
        self._server = server
        if isinstance(server.transport, asyncio.Server):
            self.port = server.transport.sockets[0].getsockname()[1]
        self._running = BackgroundTask(f"{self.host}:{self.port}", "the gripper", self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close all connections and stop listening."""
        if self._running:
            await self._running.end()
        if self._server:
            self._server.close()
            await asyncio.sleep(0)  # lets the sockets close
        self._server = None

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
        written: list[int] | list[bool] | None,
        /,
    ) -> ExcCodes | None:
        """Execute a request; pymodbus sends the registers in `current` as the answer."""
        if self.refusing:
            return ExcCodes.DEVICE_FAILURE
        if function == WRITE and written is not None:
            data = b"".join(int(value).to_bytes(2, "big") for value in written)
            self._written[2 * address : 2 * address + len(data)] = data
            self.mechanism.request(decode_request(bytes(self._written)), self._now())
        elif function == READ:
            status = encode_status(self.mechanism.status(self._now()))
            current[:STATUS] = [int.from_bytes(status[i : i + 2], "big") for i in range(0, 2 * STATUS, 2)]
        else:
            return ExcCodes.ILLEGAL_FUNCTION
        return None

    def _pass_on(self, sending: bool, data: bytes) -> bytes:  # noqa: FBT001 - as pymodbus calls it
        return b"" if sending and self.silent else self.trace(sending, data)


async def _refuse(*_: object) -> ExcCodes:
    """Refuse a request to another unit."""
    return ExcCodes.GATEWAY_NO_RESPONSE
