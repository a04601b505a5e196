"""Control of a gripper over successive connections: activation, requests and status."""

import asyncio
import logging
from collections.abc import Callable
from dataclasses import replace
from math import inf
from typing import Final

from connectors.gripper.modbus_link import GripperLink
from connectors.gripper.robotiq import Request, Status
from operators.errors import EndpointError

log = logging.getLogger("slipflow")

ACTIVATION: Final = 30.0  # s, longest time until the gripper is ready
POLL: Final = 0.1  # s between two status requests


class GripperDrive:
    """Controller of a gripper.

    Args:
        new_link: Returns a link that is not yet connected.
        target: Request that sets the target; it is not sent before `go` is set.
        counted: Counters; ``sent`` and ``restarts`` are incremented.
        timeout: Longest wait for the echo of a request, s.

    Attributes:
        target: Request that sets the target.
        status: Newest status after the newest request was echoed; None before the first of a connection.
        ready: True if the gripper accepts requests.
    """

    def __init__(
        self, new_link: Callable[[], GripperLink], target: Request, counted: dict[str, int], timeout: float
    ) -> None:
        self.target = target
        self._new_link, self._counted, self._timeout = new_link, counted, timeout
        self._changed = asyncio.Event()
        self._was_ready = False  # the gripper was ready when it last answered
        self._link: GripperLink | None = None
        self.drop()

    def drop(self) -> None:
        """Close the connection, if there is one."""
        if self._link:
            self._link.close()
        self._link, self.ready = None, False
        self.status: Status | None = None
        self._sent: Request | None = None  # newest request of this connection
        self._due = -inf  # loop time (s) of the next status request
        self._requested = 0.0  # loop time (s) of the newest request whose echo is checked
        self._waiting = 0.0  # loop time (s), start of the wait for readiness

    @property
    def connected(self) -> bool:
        """True from `connect` to `drop`."""
        return self._link is not None

    @property
    def pending(self) -> bool:
        """True if the target has not been sent over this connection."""
        return self.target.go and self.target != self._sent

    def grip(self, force: int) -> None:
        """Set the force, as a register value."""
        self.target = replace(self.target, go=True, force=force)
        self._changed.set()

    async def connect(self) -> GripperLink:
        """Connect.

        Raises:
            EndpointError: if the gripper cannot be reached.
        """
        self._link = link = self._new_link()
        self._waiting = asyncio.get_running_loop().time()
        await link.connect()
        return link

    async def start(self) -> None:
        """Connect, reset a fault, activate the gripper and send the target if it is set.

        Raises:
            EndpointError: if the gripper fails.
        """
        link = await self.connect()
        if (await link.read_status()).needs_reset:
            await link.write(Request())
        while not self.ready or self.pending:
            await self.step()

    async def step(self) -> None:
        """Connect, read the status or send the target if due, else wait until one of them is due.

        Raises:
            EndpointError: if the gripper fails; the connection must then be dropped.
        """
        link, loop = self._link or await self.connect(), asyncio.get_running_loop()
        now = loop.time()
        if now >= self._due:
            self._due = loop.time() + await self._check_status(link)
        elif self.ready and self.pending:
            await link.wait_turn()
            await self._send(link, self.target)  # read after the wait, so it is the newest
        else:
            self._changed.clear()
            try:
                async with asyncio.timeout(self._due - now):
                    await self._changed.wait()
            except TimeoutError:
                pass

    async def _check_status(self, link: GripperLink) -> float:
        """Read the status, and activate the gripper if needed.

        Returns:
            Time until the next status request, s.
        """
        status, now = await link.read_status(), asyncio.get_running_loop().time()
        if status.needs_reset:
            raise EndpointError(link.endpoint, status.reason)
        if status.active and self._sent and status.echo != self._sent.position:
            if now - self._requested > self._timeout:
                reason = f"does not accept a request within {self._timeout} s"
                raise EndpointError(link.endpoint, f"{reason}: does another program command it?")
            return 0.0
        self.status = status
        if status.ready:
            self.ready = self._was_ready = True
            return POLL
        if self._was_ready:
            log.warning("%s has restarted: activating it again", link.endpoint)
            self._counted["restarts"] += 1
            self.ready = self._was_ready = False
            self._sent, self._waiting = None, now
        if now - self._waiting > ACTIVATION:
            reason = f"is not ready within {ACTIVATION} s: does something obstruct its fingers?"
            raise EndpointError(link.endpoint, reason)
        if not status.active:
            await self._send(link, Request(active=True))
        return POLL

    async def _send(self, link: GripperLink, request: Request) -> None:
        await link.write(request)
        if self._sent is None or replace(self._sent, force=request.force) != request:
            self._requested = self._due = asyncio.get_running_loop().time()
        self._sent = request
        self._counted["sent"] += 1
