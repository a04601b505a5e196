"""Control of a gripper over one connection: activation, requests and status."""

import asyncio
import logging
from dataclasses import dataclass, field, replace
from math import inf

from connectors.gripper.modbus_link import GripperLink
from connectors.gripper.robotiq import Phase, Request, Status
from operators.errors import EndpointError

log = logging.getLogger("slipflow")


@dataclass
class GripTarget:
    """Target of a gripper; it is not sent before `request.go` is set.

    Attributes:
        request: Request that sets the target.
        sent: True if the newest force was sent, over any connection.
        changed: Event, set by a new force.
    """

    request: Request
    sent: bool = True
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    def grip(self, force: int) -> None:
        """Set the force, as a register value."""
        request = replace(self.request, go=True, force=force)
        self.sent = self.sent and request == self.request
        self.request = request
        self.changed.set()


class GripperDrive:
    """Controller of a gripper over one connection.

    Args:
        link: The connection.
        target: Target of the gripper.
        was_ready: True if the gripper was ready when it last answered.
        counted: Counters; ``sent`` and ``restarts`` are incremented.
        timeout: Longest time until the status echoes a request, s.
        activation: Longest time until the gripper is ready, s.
        poll: Time between two status requests, s.

    Attributes:
        status: Newest status after the newest request was echoed; None before the first.
        sent: Newest request; None before the first.
        ready: True if the gripper accepts requests.
        was_ready: True if the gripper was ready when it last answered.
    """

    def __init__(
        self,
        link: GripperLink,
        target: GripTarget,
        counted: dict[str, int],
        *,
        was_ready: bool,
        timeout: float,
        activation: float,
        poll: float,
    ) -> None:
        self.link, self.was_ready, self._target, self._counted = link, was_ready, target, counted
        self._timeout, self._activation, self._poll = timeout, activation, poll
        self.status: Status | None = None
        self.sent: Request | None = None
        self.ready = False
        self._loop = asyncio.get_running_loop()
        self._due = -inf  # loop time (s) of the next status request
        self._requested = 0.0  # loop time (s) of the newest request whose echo is checked
        self._waiting = self._loop.time()  # loop time (s), start of the wait for readiness

    @property
    def pending(self) -> bool:
        """True if the target has not been sent."""
        return self._target.request.go and self._target.request != self.sent

    async def reset(self) -> None:
        """Reset the gripper if its fault requires it.

        Raises:
            EndpointError: if the gripper fails.
        """
        if (await self.link.read_status()).needs_reset:
            await self.link.write(Request())

    async def step(self) -> None:
        """Read the status or send the target if due, else wait until one of them is due.

        Raises:
            EndpointError: if the gripper fails; a new connection is then required.
        """
        now = self._loop.time()
        if now >= self._due:
            self._due = self._loop.time() + await self._check_status()
        elif self.ready and self.pending:
            await self.link.wait_turn()
            await self._send(self._target.request)  # read after the wait, so it is the newest
        else:
            self._target.changed.clear()
            try:
                async with asyncio.timeout(self._due - now):
                    await self._target.changed.wait()
            except TimeoutError:
                pass

    async def _check_status(self) -> float:
        """Read the status, and activate the gripper if needed.

        Returns:
            Time until the next status request, s.
        """
        status, now = await self.link.read_status(), self._loop.time()
        if status.needs_reset:
            raise EndpointError(self.link.endpoint, status.reason)
        if status.active and self.sent and status.echo != self.sent.position:
            if now - self._requested > self._timeout:
                raise EndpointError(
                    self.link.endpoint,
                    f"does not accept a request within {self._timeout} s: does another program command it?",
                )
            return 0.0
        self.status = status
        if status.ready and status.mode is self._target.request.mode:
            self.ready = self.was_ready = True
            return self._poll
        if self.was_ready:
            log.warning("%s has restarted: activating it again", self.link.endpoint)
            self._counted["restarts"] += 1
            self.ready = self.was_ready = False
            self.sent, self._waiting = None, now
        if now - self._waiting > self._activation:
            raise EndpointError(
                self.link.endpoint,
                f"is not ready within {self._activation} s: does something obstruct its fingers?",
            )
        if not status.active:
            await self._send(Request(active=True))
        elif status.phase is Phase.READY:
            await self._send(replace(self._target.request, go=False))  # sets its mode
        return self._poll

    async def _send(self, request: Request) -> None:
        on_target = request == self._target.request
        self._target.sent = self._target.sent or on_target
        try:
            await self.link.write(request)
        except BaseException:
            self._target.sent = self._target.sent and not on_target
            raise
        if self.sent is None or replace(self.sent, force=request.force) != request:
            self._requested = self._due = self._loop.time()
        self.sent = request
        self._counted["sent"] += 1
