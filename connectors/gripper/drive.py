"""Bringing a gripper to what is wanted of it, and keeping it there."""

import asyncio
import logging
from dataclasses import dataclass, field, replace
from math import inf

from connectors.gripper.modbus_link import GripperLink
from connectors.gripper.robotiq import Phase, Request, Status
from operators.errors import EndpointError

log = logging.getLogger("slipflow")


@dataclass
class Wanted:
    """What a gripper is to do; nothing is sent for it before its fingers are to go.

    Attributes:
        request: That says so.
        sent: Whether the newest force was, over any connection.
        news: Set by a new force.
    """

    request: Request
    sent: bool = True
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def grip(self, force: int) -> None:
        """Have it grip with a force, as its register has it."""
        request = replace(self.request, go=True, force=force)
        self.sent = self.sent and request == self.request
        self.request = request
        self.news.set()


class GripperDrive:
    """What is known of a gripper over one connection, and what is to be done next.

    Args:
        link: The connection.
        wanted: What it is to do.
        known: Whether it was ready when it was last heard of.
        counted: ``sent`` requests and ``restarts`` are added to.
        patience: Seconds until a request is echoed.
        activation: Seconds until the gripper is ready.
        poll: Seconds from look to look.

    Attributes:
        status: What it said last, once it had taken the newest request; None: nothing yet.
        sent: The newest request; None: nothing yet.
        ready: Whether it obeys.
        known: Whether it was ready when it was last heard of.
    """

    def __init__(
        self,
        link: GripperLink,
        wanted: Wanted,
        counted: dict[str, int],
        *,
        known: bool,
        patience: float,
        activation: float,
        poll: float,
    ) -> None:
        self.link, self.known, self._wanted, self._counted = link, known, wanted, counted
        self._patience, self._activation, self._poll = patience, activation, poll
        self.status: Status | None = None
        self.sent: Request | None = None
        self.ready = False
        self._loop = asyncio.get_running_loop()
        self._due = -inf  # s of the loop, of the next look
        self._asked = 0.0  # s of the loop, when something that is echoed was sent
        self._waiting = self._loop.time()  # since when it is to be ready

    @property
    def pending(self) -> bool:
        """Whether something is wanted that has not been sent."""
        return self._wanted.request.go and self._wanted.request != self.sent

    async def reset(self) -> None:
        """End a fault that only a reset ends.

        Raises:
            EndpointError: if the gripper fails.
        """
        if (await self.link.look()).needs_reset:
            await self.link.ask(Request())

    async def turn(self) -> None:
        """Do what is due, or wait until something is.

        Raises:
            EndpointError: if the gripper fails; this is over then.
        """
        now = self._loop.time()
        if now >= self._due:
            self._due = self._loop.time() + await self._look()
        elif self.ready and self.pending:
            await self.link.turn()
            await self._send(self._wanted.request)  # the newest by now
        else:
            self._wanted.news.clear()
            try:
                async with asyncio.timeout(self._due - now):
                    await self._wanted.news.wait()
            except TimeoutError:
                pass

    async def _look(self) -> float:
        """Look at it, and see to it that it is ready.

        Returns:
            Seconds until it is to be looked at again.
        """
        status, now = await self.link.look(), self._loop.time()
        if status.needs_reset:
            raise EndpointError(self.link.place, status.reason)
        if status.active and self.sent and status.echo != self.sent.position:
            if now - self._asked > self._patience:
                raise EndpointError(
                    self.link.place,
                    f"does not take a request within {self._patience} s: does another program command it?",
                )
            return 0.0
        self.status = status
        if status.ready and status.mode is self._wanted.request.mode:
            self.ready = self.known = True
            return self._poll
        if self.known:
            log.warning("%s has restarted: it is activated again", self.link.place)
            self._counted["restarts"] += 1
            self.ready = self.known = False
            self.sent, self._waiting = None, now
        if now - self._waiting > self._activation:
            raise EndpointError(
                self.link.place,
                f"is not ready within {self._activation} s: does something obstruct its fingers?",
            )
        if not status.active:
            await self._send(Request(active=True))
        elif status.phase is Phase.READY:
            await self._send(replace(self._wanted.request, go=False))  # for its mode
        return self._poll

    async def _send(self, request: Request) -> None:
        obeyed = request == self._wanted.request
        self._wanted.sent = self._wanted.sent or obeyed
        try:
            await self.link.ask(request)
        except BaseException:
            self._wanted.sent = self._wanted.sent and not obeyed
            raise
        if self.sent is None or replace(self.sent, force=request.force) != request:
            self._asked = self._due = self._loop.time()
        self.sent = request
        self._counted["sent"] += 1
