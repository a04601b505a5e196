"""RTDE client that subscribes to a controller's outputs and timestamps each package on arrival."""

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Mapping
from typing import Final, TypeAlias, TypeVar, cast

import numpy as np

from connectors.ur.rtde import (
    PROTOCOL,
    Kind,
    Packages,
    RtdeError,
    Version,
    ask_outputs,
    granted_types,
    pack,
    text,
)
from operators.batch import Times, s
from operators.errors import EndpointError, os_error_reason
from operators.ports import Clock

T = TypeVar("T")
Rows: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.void]]"  # fields are outputs

TURN: Final = 1 << 14  # bytes per turn of the event loop, so that a flood of messages delays nothing
TEXTS: Final = 10  # messages that are logged per minute
BACKLOG: Final = 16_384  # unread packages (30 s at 500 Hz); beyond it the client stops reading

NO_ANSWER: Final = "does not answer within {} s: check its address and its power"
_NO_DATA: Final = "sent nothing for {} s: check that it runs and is connected"
_NUMPY: Final = {"DOUBLE": (">f8", ()), "VECTOR6D": (">f8", 6), "INT32": (">i4", ())}  # element, shape
_REFUSED: Final = (
    "refuses the connection: check its address, and that RTDE is enabled"
    " (e-Series: Settings, Security, Services)"
)

log = logging.getLogger("slipflow")


class RtdeClient(asyncio.BufferedProtocol):
    """One connection to a controller.

    A package is timestamped when the event loop reads it, not when `receive` returns it.

    Args:
        clock: Clock of the arrival times.
        host: Address of the controller.
        port: RTDE port.
        outputs: RTDE types of the requested variables, by name.
        rate: Packages per second, Hz.
        timeout: Longest wait for the connection and between packages, s.

    Attributes:
        endpoint: Address in error messages.
        controller: Software version; None before the controller has sent it.
        texts: Messages that the controller sent.
    """

    def __init__(
        self, clock: Clock, host: str, port: int, outputs: Mapping[str, str], *, rate: float, timeout: float
    ) -> None:
        self.endpoint = f"rtde://{host}:{port}"
        self.controller: Version | None = None
        self._address, self._clock, self._timeout = (host, port), clock, timeout
        self._outputs, self._rate = outputs, rate
        fields = ((name, *_NUMPY[kind]) for name, kind in outputs.items())
        self._row = np.dtype([("recipe", "u1"), *fields])
        self._packages, self._recipe, self._buffer = Packages(), 0, memoryview(bytearray(TURN))
        self.texts, self._logged, self._minute = (
            0,
            0,
            clock.now(),
        )  # `_logged` counts those since `_minute`, ns
        self._expected = Kind.PROTOCOL  # kind of the next answer; DATA once the controller sends
        self._received = deque[tuple[int, bytes]]()  # arrival (ns) and payload
        self._transport: asyncio.Transport | None = None
        self._error: Exception | None = None
        self._changed, self._closed = asyncio.Event(), asyncio.Event()

    async def connect(self) -> None:
        """Connect and request the outputs.

        Raises:
            EndpointError: if the controller does not accept the connection in time.
        """
        loop = asyncio.get_running_loop()
        await self._in_time(loop.create_connection(lambda: self, *self._address), NO_ANSWER)

    async def receive(self) -> tuple[Times, Rows]:
        """Wait for data; return all unread packages: arrival times and rows with the outputs, (n,), n >= 1.

        Raises:
            EndpointError: if the connection fails, the controller violates the protocol, or no package
                arrives in time.
        """
        await self._in_time(self._unread(), _NO_DATA)
        arrivals, payloads = zip(*self._received, strict=True)
        self._received.clear()
        if self._transport:
            self._transport.resume_reading()
        return np.array(arrivals, np.int64), np.frombuffer(b"".join(payloads), self._row)

    async def close(self) -> None:
        """Close the connection."""
        if self._transport:
            self._transport.abort()
            await self._closed.wait()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the handshake. asyncio has set TCP_NODELAY."""
        self._transport = cast("asyncio.Transport", transport)
        self._request(Kind.PROTOCOL, PROTOCOL.to_bytes(2, "big"))

    def get_buffer(self, sizehint: int) -> memoryview:
        """Return the space for the bytes of one turn of the event loop."""
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Handle the bytes that arrived in the buffer."""
        self.data_received(bytes(self._buffer[:nbytes]))

    def data_received(self, data: bytes) -> None:
        """Timestamp and store the packages that `data` completes."""
        arrival = self._clock.now()
        try:
            for kind, payload in self._packages.feed(data):
                self._take(kind, payload, arrival)
        except RtdeError as error:
            unknown = self.controller is None
            self._fail(RtdeError(f"is not an RTDE server: {error}") if unknown else error)
        if self._received:
            self._changed.set()
        if len(self._received) >= BACKLOG and self._transport:
            self._transport.pause_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        """Store the error; earlier packages can still be received."""
        self._fail(exc or ConnectionError("the controller closed the connection"))
        self._closed.set()

    def _take(self, kind: int, payload: bytes, arrival: int) -> None:
        """Handle one package."""
        if kind == Kind.TEXT:
            self._count_text(payload, arrival)
        elif kind != self._expected:
            raise RtdeError(f"received package {chr(kind)!r}, expected {chr(self._expected)!r}")
        elif kind == Kind.DATA:
            if payload[:1] != bytes([self._recipe]) or len(payload) != self._row.itemsize:
                found = f"{len(payload)} bytes for recipe {payload[:1].hex() or 'none'}"
                raise RtdeError(f"data of {found}, not {self._row.itemsize} for {self._recipe:02x}")
            self._received.append((arrival, payload))
        else:
            self._answer(payload)

    def _count_text(self, payload: bytes, arrival: int) -> None:
        """Count a message, and log it unless `TEXTS` of this minute were logged."""
        self.texts += 1
        if arrival - self._minute > 60 * s:
            self._minute, self._logged = arrival, 0
        self._logged += 1
        if self._logged <= TEXTS:
            log.warning("controller: %s", text(payload))
        elif self._logged == TEXTS + 1:
            log.warning(
                "%s sends many messages: they are counted, and %d a minute logged", self.endpoint, TEXTS
            )

    def _answer(self, payload: bytes) -> None:
        """Handle the answer to the newest request, and send the next request."""
        match self._expected:
            case Kind.PROTOCOL:
                if payload != b"\1":
                    reason = f"the controller does not support RTDE version {PROTOCOL}: update its software"
                    raise RtdeError(reason)
                self._request(Kind.CONTROLLER)
            case Kind.CONTROLLER:
                self.controller = Version.read(payload)
                self._request(Kind.OUTPUTS, ask_outputs(self._rate, [*self._outputs]))
            case Kind.OUTPUTS:
                self._recipe, types = granted_types([*self._outputs], payload)
                self._check_types(types)
                self._request(Kind.START)
            case _:
                if payload != b"\1":
                    raise RtdeError("the controller refused to start sending")
                self._expected = Kind.DATA

    def _check_types(self, types: tuple[str, ...]) -> None:
        wrong = ", ".join(
            f"{name} as {found}, must be {expected}"
            for (name, expected), found in zip(self._outputs.items(), types, strict=True)
            if found != expected
        )
        if wrong:
            raise RtdeError(f"the controller sends {wrong}: slipflow does not support its software version")

    def _request(self, kind: Kind, payload: bytes = b"") -> None:
        self._expected = kind
        if self._transport:
            self._transport.write(pack(kind, payload))

    def _fail(self, error: Exception) -> None:
        self._error = self._error or error
        self._changed.set()

    async def _unread(self) -> None:
        """Wait until a package can be read.

        Raises:
            OSError: if the connection is lost.
            RtdeError: if the controller violates the protocol.
        """
        while not self._received:
            if self._error:
                raise self._error
            self._changed.clear()
            await self._changed.wait()

    async def _in_time(self, awaited: Awaitable[T], late: str) -> T:
        """Wait at most `timeout`; every failure becomes an EndpointError."""
        try:
            async with asyncio.timeout(self._timeout):
                return await awaited
        except TimeoutError as error:
            raise EndpointError(self.endpoint, late.format(self._timeout)) from error
        except ConnectionRefusedError as error:
            raise EndpointError(self.endpoint, _REFUSED) from error
        except OSError as error:
            raise EndpointError(self.endpoint, os_error_reason(error)) from error
        except RtdeError as error:
            raise EndpointError(self.endpoint, str(error)) from error
