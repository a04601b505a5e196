"""Mechanism of an emulated Robotiq 3-Finger gripper, driven by its registers.

The three fingers move as one at a constant speed and stop where they meet the object, which they grip with
the requested force from that instant on. They are self-locking: a larger force grips harder, a smaller one
changes nothing until they open. All durations are assumed, except the 10 ms until the status shows a request.
Only the basic mode is emulated.
"""

from collections import deque
from typing import Final, Protocol

import numpy as np

from connectors.gripper.grip_force import ForceScale
from connectors.gripper.robotiq import FULL, SETTLE, Fingers, Phase, Request, Status
from operators.batch import Commands, s

SLOWEST: Final = 7.0  # s from open to closed at speed 0
FASTEST: Final = 1.4  # s from open to closed at full speed
NOT_ACTIVATED: Final = 7  # fault
ACTIVATING: Final = 5  # fault
SCISSOR: Final = 137  # position of the scissor axis in the basic mode


class ForceReceiver(Protocol):
    """Receiver of the grip force, such as a `SharedScene`."""

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
        scale: Force of the force register's values.

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
        scale: ForceScale | None = None,
    ) -> None:
        self.contact, self.force = contact, 0.0
        self._scene, self._scale = scene, scale or ForceScale()
        self._activation = round(activation * s)
        self._time, self._position = now, 0.0
        self._pending = deque[tuple[int, Request]]()  # (time of effect in ns, request)
        self.power_up()

    def power_up(self) -> None:
        """Reset the registers; the fingers stay where they are."""
        self._current, self._phase, self._fault = Request(), Phase.RESET, 0
        self._until: int | None = None  # end of the activation
        self._pending.clear()

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
            force = max(self.force, self._scale.force(self._current.force))
            self._grip(force, since + round(distance / speed * s))

    def _fingers(self) -> Fingers:
        if self._position == self._current.position:
            return Fingers.ARRIVED
        return Fingers.ALL_STOPPED if self.force else Fingers.MOVING

    def _grip(self, force: float, instant: int) -> None:
        """Grip with a force (N) from an instant on."""
        if force != self.force:
            self.force = force
            self._scene.command(Commands(np.array([instant]), np.array([force]), np.full((1, 6), np.nan)))


def encode_status(status: Status) -> bytes:
    """Return the 16 bytes of a status' registers; the motors report no current."""
    if not status.active:
        return bytes([status.phase << 4, 0, status.fault, status.echo]) + bytes(12)
    gripper = status.active | status.go << 3 | status.phase << 4 | status.fingers << 6
    axes = int(status.fingers) * 0b010101 | 0b11000000 if status.go else 0
    a, b, c = status.positions
    return bytes([gripper, axes, status.fault, status.echo, a, 0, 0, b, 0, 0, c, 0, 0, SCISSOR, 0, 0])
