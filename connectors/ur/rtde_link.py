"""A client's connection to a controller over RTDE: stamps what arrives, and keeps it until it is taken."""

import asyncio
from collections import deque
from collections.abc import Sequence
from typing import Final, cast

import numpy as np

from connectors.ur.rtde import RtdeError, Version
from connectors.ur.rtde_subscription import Subscription
from operators.batch import Times
from operators.errors import os_error_reason
from operators.ports import Clock

SILENT: Final = "does not answer for {} s: is this its address, and is it on?"
STALLED: Final = "sends nothing for {} s: does it run, and is the cable in?"
BACKLOG: Final = 16_384  # packages, half a minute, that may wait to be taken; then the controller has to wait


class RtdeLink(asyncio.Protocol):
    """One connection, to be made by the event loop's `create_connection`.

    A package is stamped when the loop reads it, not when somebody comes to take it.

    Args:
        clock: Tells the arrivals.
        outputs: Names of the variables that are asked for.
        rate: Hz.
    """

    def __init__(self, clock: Clock, outputs: Sequence[str], rate: float) -> None:
        self._clock, self._subscription = clock, Subscription(outputs, rate)
        self._waiting = deque[tuple[int, bytes]]()  # arrival (ns) and payload
        self._transport: asyncio.Transport | None = None
        self._error: Exception | None = None
        self._more, self._lost = asyncio.Event(), asyncio.Event()

    @property
    def controller(self) -> Version:
        """The controller's version, which is known once it sent a package."""
        assert self._subscription.controller
        return self._subscription.controller

    @property
    def types(self) -> tuple[str, ...]:
        """The types of the outputs, which are known once it sent a package."""
        assert self._subscription.recipe
        return self._subscription.recipe.types

    async def take(self) -> tuple[Times, bytes]:
        """All that waits: arrivals (n,), n at least 1, and the payloads, one behind the other.

        Raises:
            OSError: if the connection is lost.
            RtdeError: if the controller refuses, or does not keep to the protocol.
        """
        while not self._waiting:
            if self._error:
                raise self._error
            self._more.clear()
            await self._more.wait()
        arrivals, payloads = zip(*self._waiting, strict=True)
        self._waiting.clear()
        if self._transport:
            self._transport.resume_reading()
        return np.array(arrivals, np.int64), b"".join(payloads)

    async def close(self) -> None:
        """Let go of the socket."""
        if self._transport:
            self._transport.abort()
            await self._lost.wait()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin the handshake; asyncio has set TCP_NODELAY."""
        self._transport = cast("asyncio.Transport", transport)
        self._send()

    def data_received(self, data: bytes) -> None:
        """Stamp what arrived."""
        arrival = self._clock.now()
        try:
            for payload in self._subscription.feed(data):
                self._waiting.append((arrival, payload))
        except RtdeError as error:
            stranger = self._subscription.controller is None
            self._fail(RtdeError(f"it does not speak RTDE: {error}") if stranger else error)
        self._send()
        if self._waiting:
            self._more.set()
        if len(self._waiting) >= BACKLOG and self._transport:
            self._transport.pause_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        """What arrived before can still be taken."""
        self._fail(exc or ConnectionError("the controller closed the connection"))
        self._lost.set()

    def _send(self) -> None:
        if self._transport and self._subscription.outgoing:
            self._transport.write(bytes(self._subscription.outgoing))
            self._subscription.outgoing.clear()

    def _fail(self, error: Exception) -> None:
        self._error = self._error or error
        self._more.set()


def reason(error: Exception) -> str:
    """Why a connection failed, and what to look at."""
    if isinstance(error, ConnectionRefusedError):
        return (
            "refuses the connection: is this its address, is it on, is RTDE enabled there"
            " (e-Series: Settings, Security, Services)?"
        )
    return os_error_reason(error) if isinstance(error, OSError) else str(error)


def mistyped(outputs: Sequence[str], types: Sequence[str], expected: Sequence[str]) -> str:
    """Which outputs a controller grants with other types than they should have.

    >>> mistyped(("timestamp", "robot_mode"), ("DOUBLE", "DOUBLE"), ("DOUBLE", "INT32"))
    'gives robot_mode as DOUBLE, must be INT32: its software is none that slipflow knows'
    """
    triples = zip(outputs, types, expected, strict=True)
    wrong = ", ".join(
        f"{name} as {found}, must be {wanted}" for name, found, wanted in triples if found != wanted
    )
    return f"gives {wrong}: its software is none that slipflow knows"
