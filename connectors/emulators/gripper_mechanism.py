"""What is inside an emulated Robotiq 3-finger gripper: it does what its registers say, as time goes by.

It is simple. The three fingers move as one, at a constant speed, and stop where they meet the object; there
they grip with the force that was asked for, from that instant on. They lock themselves: asked for more force
they grip harder, asked for less they stay as they are, until they open. Its times are guesses, apart from the
10 ms until a request shows.
"""

from collections import deque
from typing import Final, Protocol

import numpy as np

from connectors.gripper.grip_force import ForceScale
from connectors.gripper.robotiq import FULL, SETTLE, Axis, Fingers, Mode, Phase, Request, Status
from operators.batch import Commands, s

SLOWEST: Final = 7.0  # s from open to closed
FASTEST: Final = 1.4  # s
RELEASING: Final = 0x0B  # faults
RELEASED: Final = 0x0F
CURRENT: Final = 14  # of a motor that moves, 0.1 mA
SCISSOR: Final = 137  # its position in the basic mode


class Gripped(Protocol):
    """What feels the fingers, such as a `Lab`."""

    def command(self, commands: Commands) -> None:
        """Take the grip force (N) from an instant on."""
        ...


class Mechanism:
    """The fingers, what they meet, and what has been asked of them. Instants are ns, and never go back.

    Args:
        scene: Is told of each change of the grip force.
        now: The instant at which it is switched on.
        met: Position, 0 to 255, at which the fingers meet an object; None: there is none.
        activation: Seconds that an activation takes; the fingers open meanwhile.
        change: Seconds that a change of mode takes.
        scale: What the force register means.

    Attributes:
        met: May be changed while the fingers are open.
        force: That the object is gripped with, N.
    """

    def __init__(
        self,
        scene: Gripped,
        now: int,
        *,
        met: int | None = 120,
        activation: float = 2.0,
        change: float = 1.0,
        scale: ForceScale | None = None,
    ) -> None:
        self.met, self.force = met, 0.0
        self._scene, self._scale = scene, scale or ForceScale()
        self._activation, self._change = round(activation * s), round(change * s)
        self._time, self._position = now, 0.0
        self._mode = Mode.BASIC  # that the fingers stand in
        self._asked = deque[tuple[int, Request]]()  # not taken yet, and when they will be
        self.restart()

    def restart(self) -> None:
        """Be switched off and on: the registers are 0, the fingers stay where they are."""
        self._taken, self._phase, self._fault = Request(), Phase.RESET, 0
        self._until: int | None = None  # the end of the phase
        self._asked.clear()

    def fail(self, fault: int) -> None:
        """Have a fault, one of `connectors.gripper.robotiq.FAULTS`, and do nothing more until it is reset."""
        self._phase, self._until, self._fault = Phase.RESET, None, fault

    def ask(self, request: Request, now: int) -> None:
        """Take a request, which has its effect `SETTLE` later."""
        self.advance(now)
        self._asked.append((now + round(SETTLE * s), request))

    def look(self, now: int) -> Status:
        """The status at an instant."""
        self.advance(now)
        taken, position = self._taken, round(self._position)
        if not taken.active:
            return Status(echo=taken.position, fault=7 if taken.go else self._fault)
        go = taken.go and self._phase is Phase.READY
        fingers, axis = self._fingers() if go else (Fingers.MOVING, Axis.MOVING)
        moving = CURRENT if go and axis is Axis.MOVING else 0
        waits = {Phase.ACTIVATING: 5, Phase.CHANGING: 6}.get(self._phase, 0) if taken.go else 0
        return Status(
            active=True,
            mode=taken.mode,
            go=go,
            phase=self._phase,
            fingers=fingers,
            axes=(axis, axis, axis, Axis.ARRIVED if go else Axis.MOVING),
            fault=self._fault or waits,
            echo=taken.position,
            positions=(position, position, position),
            currents=(moving, moving, moving),
            scissor=SCISSOR,
        )

    def advance(self, now: int) -> None:
        """Let time go by."""
        while True:
            asked = self._asked[0][0] if self._asked else now
            due = min(now, asked, now if self._until is None else self._until)
            self._move(due)
            if self._until is not None and self._until <= due:
                self._complete()
            elif self._asked and self._asked[0][0] <= due:
                self._take(self._asked.popleft()[1])
            else:
                return

    def _take(self, request: Request) -> None:
        """Begin what a request asks for."""
        before, self._taken = self._taken, request
        if not request.active:
            self._phase, self._until, self._fault = Phase.RESET, None, 0
        elif not before.active:
            self._phase, self._until = Phase.ACTIVATING, self._time + self._activation
            self._mode = Mode.BASIC
        elif self._fault:
            return
        elif request.release:
            self._phase, self._until, self._fault = Phase.RESET, None, RELEASING
        elif self._phase is Phase.READY and request.mode is not self._mode:
            self._phase, self._until = Phase.CHANGING, self._time + self._change

    def _complete(self) -> None:
        """End a phase."""
        if self._phase is Phase.CHANGING:
            self._mode = self._taken.mode
        self._phase, self._until = Phase.READY, None
        self._take(self._taken)

    def _goal(self) -> tuple[int, float] | None:
        """Where the fingers go, and how fast (1/s); None: they stay."""
        if self._fault == RELEASING:
            return 0, FULL / SLOWEST
        if self._phase is Phase.ACTIVATING:
            return 0, FULL / FASTEST
        if self._phase is Phase.READY and self._taken.go:
            part = self._taken.speed / FULL
            return self._taken.position, FULL / SLOWEST + part * (FULL / FASTEST - FULL / SLOWEST)
        return None

    def _move(self, until: int) -> None:
        """Move the fingers for a while."""
        since, self._time = self._time, max(self._time, until)
        if (going := self._goal()) is None:
            return
        goal, speed = going
        reach = speed * (self._time - since) / s
        if goal < self._position:
            self._grip(0.0, since)
            self._position = max(float(goal), self._position - reach)
            if self._fault == RELEASING and not self._position:
                self._fault = RELEASED
            return
        end = float(goal if self.met is None or self.met < self._position else min(goal, self.met))
        way = end - self._position
        self._position = end if way <= reach else self._position + reach
        if way <= reach and end < goal:
            force = max(self.force, self._scale.force(self._taken.force))
            self._grip(force, since + round(way / speed * s))

    def _fingers(self) -> tuple[Fingers, Axis]:
        """How far they have come."""
        if self._position == self._taken.position:
            return Fingers.ARRIVED, Axis.ARRIVED
        if self.force:
            return Fingers.ALL_STOPPED, Axis.STOPPED_CLOSING
        return Fingers.MOVING, Axis.MOVING

    def _grip(self, force: float, instant: int) -> None:
        """Grip with a force (N) from an instant on."""
        if force != self.force:
            self.force = force
            self._scene.command(Commands(np.array([instant]), np.array([force]), np.full((1, 6), np.nan)))
