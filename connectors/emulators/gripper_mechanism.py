"""Mechanism of an emulated Robotiq 3-Finger gripper, driven by its registers.

The three fingers move as one at a constant speed and stop where they meet the object, which they grip with
the requested force from that instant on. They are self-locking: a larger force grips harder, a smaller one
changes nothing until they open. All durations are assumed, except the 10 ms until the status shows a request.
"""

from collections import deque
from typing import Final, Protocol

import numpy as np

from connectors.gripper.grip_force import ForceScale
from connectors.gripper.robotiq import FULL, SETTLE, Axis, Fingers, Mode, Phase, Request, Status
from operators.batch import Commands, s

SLOWEST: Final = 7.0  # s from open to closed at speed 0
FASTEST: Final = 1.4  # s from open to closed at full speed
RELEASING: Final = 0x0B  # fault: automatic release in progress
RELEASED: Final = 0x0F  # fault: automatic release completed
MOTOR_CURRENT: Final = 14  # 0.1 mA, while a motor moves
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
        mode_change: Duration of a mode change (s).
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
        mode_change: float = 1.0,
        scale: ForceScale | None = None,
    ) -> None:
        self.contact, self.force = contact, 0.0
        self._scene, self._scale = scene, scale or ForceScale()
        self._activation, self._mode_change = round(activation * s), round(mode_change * s)
        self._time, self._position = now, 0.0
        self._mode = Mode.BASIC  # current mode of the fingers
        self._pending = deque[tuple[int, Request]]()  # (time of effect in ns, request)
        self.power_up()

    def power_up(self) -> None:
        """Reset the registers; the fingers stay where they are."""
        self._current, self._phase, self._fault = Request(), Phase.RESET, 0
        self._until: int | None = None  # end of the phase
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
            return Status(echo=request.position, fault=7 if request.go else self._fault)
        go = request.go and self._phase is Phase.READY
        fingers, axis = self._fingers() if go else (Fingers.MOVING, Axis.MOVING)
        moving = MOTOR_CURRENT if go and axis is Axis.MOVING else 0
        waits = {Phase.ACTIVATING: 5, Phase.CHANGING: 6}.get(self._phase, 0) if request.go else 0
        return Status(
            active=True,
            mode=request.mode,
            go=go,
            phase=self._phase,
            fingers=fingers,
            axes=(axis, axis, axis, Axis.ARRIVED if go else Axis.MOVING),
            fault=self._fault or waits,
            echo=request.position,
            positions=(position, position, position),
            currents=(moving, moving, moving),
            scissor=SCISSOR,
        )

    def advance(self, now: int) -> None:
        """Simulate up to an instant."""
        while True:
            effective = self._pending[0][0] if self._pending else now
            due = min(now, effective, now if self._until is None else self._until)
            self._move(due)
            if self._until is not None and self._until <= due:
                self._complete()
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
            self._mode = Mode.BASIC
        elif self._fault:
            return
        elif request.release:
            self._phase, self._until, self._fault = Phase.RESET, None, RELEASING
        elif self._phase is Phase.READY and request.mode is not self._mode:
            self._phase, self._until = Phase.CHANGING, self._time + self._mode_change

    def _complete(self) -> None:
        """End the current phase, then apply the current request."""
        if self._phase is Phase.CHANGING:
            self._mode = self._current.mode
        self._phase, self._until = Phase.READY, None
        self._start(self._current)

    def _target(self) -> tuple[int, float] | None:
        """Return target position and speed (positions per second); None if the fingers must not move."""
        if self._fault == RELEASING:
            return 0, FULL / SLOWEST
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
            if self._fault == RELEASING and not self._position:
                self._fault = RELEASED
            return
        contact = self.contact
        end = float(goal if contact is None or contact < self._position else min(goal, contact))
        distance = end - self._position
        self._position = end if distance <= travel else self._position + travel
        if distance <= travel and end < goal:
            force = max(self.force, self._scale.force(self._current.force))
            self._grip(force, since + round(distance / speed * s))

    def _fingers(self) -> tuple[Fingers, Axis]:
        """Return the state of the fingers and of their axes."""
        if self._position == self._current.position:
            return Fingers.ARRIVED, Axis.ARRIVED
        if self.force:
            return Fingers.ALL_STOPPED, Axis.STOPPED_CLOSING
        return Fingers.MOVING, Axis.MOVING

    def _grip(self, force: float, instant: int) -> None:
        """Grip with a force (N) from an instant on."""
        if force != self.force:
            self.force = force
            self._scene.command(Commands(np.array([instant]), np.array([force]), np.full((1, 6), np.nan)))
