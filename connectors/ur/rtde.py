"""Client of UR's Real-Time Data Exchange (RTDE), version 2, which timestamps each package on arrival.

A connection carries packages: uint16 size (including these three bytes), uint8 kind, payload; all numbers are
big-endian. A client requests a *recipe* of outputs by name, receives their types, and then their values at
the requested rate.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".
"""

import asyncio
import logging
from collections.abc import Awaitable, Mapping
from contextlib import suppress
from enum import IntEnum
from struct import Struct
from typing import Final, TypeAlias, TypeVar

import numpy as np

from operators.batch import Times
from operators.errors import EndpointError, SlipflowError, os_error_reason
from operators.ports import Clock
from storage.background_task import BackgroundTask

T = TypeVar("T")
Rows: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.void]]"  # fields are outputs

PORT: Final = 30004
PROTOCOL: Final = 2  # version
LARGEST: Final = 8192  # bytes of a package, twice the size of all variables of a controller
TIMEOUT: Final = 1.0  # s, for the connection and between packages
TEXTS: Final = 10  # messages that are logged per connection
BACKLOG: Final = 16_384  # unread packages (30 s at 500 Hz); beyond it the client stops reading

_NO_ANSWER: Final = f"does not answer within {TIMEOUT:g} s: check its address and its power"
_NO_DATA: Final = f"sent nothing for {TIMEOUT:g} s: check that it runs and is connected"
_NUMPY: Final = {"DOUBLE": (">f8", ()), "VECTOR6D": (">f8", 6), "INT32": (">i4", ())}  # element, shape
_REFUSED: Final = (
    "refuses the connection: check its address, and that RTDE is enabled"
    " (e-Series: Settings, Security, Services)"
)
_REFUSALS: Final = {"NOT_FOUND", "IN_USE"}  # instead of a type
_HEADER: Final = Struct(">HB")
_VERSION: Final = Struct(">4I")
_RATE: Final = Struct(">d")

log = logging.getLogger("slipflow")


class RtdeError(SlipflowError):
    """Violation of the protocol, or refusal of a request, by a peer."""


class Kind(IntEnum):
    """Kind of a package, the same for a request and its answer."""

    PROTOCOL = ord("V")  # uint16 version -> bool
    CONTROLLER = ord("v")  # -> uint32 major, minor, bugfix, build
    TEXT = ord("M")  # from the controller: uint8 length, message, uint8 length, source, uint8 level
    DATA = ord("U")  # from the controller: uint8 number of the recipe, packed values
    OUTPUTS = ord("O")  # double rate, names -> uint8 number of the recipe, types
    START = ord("S")  # -> bool


def pack(kind: int, payload: bytes = b"") -> bytes:
    r"""Return a package as bytes.

    >>> pack(Kind.PROTOCOL, b"\0\2").hex(" ")
    '00 05 56 00 02'
    """
    return _HEADER.pack(_HEADER.size + len(payload), kind) + payload


def granted_recipe(asked: Mapping[str, str], payload: bytes) -> int:
    r"""Return the number of the recipe that a controller's answer grants.

    `asked` has the types of the requested variables, by name.

    Raises:
        RtdeError: if the controller refuses, or sends other types.

    >>> granted_recipe({"timestamp": "DOUBLE", "actual_q": "VECTOR6D"}, b"\1DOUBLE,VECTOR6D")
    1
    """
    number, kinds = payload[:1], payload[1:].decode("ascii", "replace").split(",")
    types = [kind.strip() for kind in kinds if kind.strip()]
    refusals = [f"{name} {kind}" for name, kind in zip(asked, types, strict=False) if kind in _REFUSALS]
    if refusals:
        raise RtdeError(f"the controller refused {', '.join(refusals)}")
    if number in (b"", b"\0"):
        raise RtdeError(f"the controller refused {', '.join(asked)}: does another program use them?")
    if types != [*asked.values()]:
        sent = f"the controller sends {', '.join(types)} as {', '.join(asked)}"
        raise RtdeError(f"{sent}: slipflow does not support its software version")
    return number[0]


def text(payload: bytes) -> str:
    r"""Return the message and the source of a text package.

    >>> text(b"\5hello\4RTDE\1")
    'hello (RTDE)'
    """
    message = payload[1 : 1 + payload[0]] if payload else b""
    source = payload[2 + len(message) : -1]
    read = f"{message.decode('utf-8', 'replace')} ({source.decode('utf-8', 'replace')})"
    return "".join(each if each.isprintable() else " " for each in read)


class RtdeClient:
    """One connection to a controller.

    A package is timestamped when the event loop reads it, not when `receive` returns it.

    Args:
        clock: Clock of the arrival times.
        host: Address of the controller.
        port: RTDE port.
        outputs: RTDE types of the requested variables, by name.
        rate: Packages per second, Hz.

    Attributes:
        endpoint: Address in error messages.
        controller: Software version, such as 5.11.0.1; empty before the controller has sent it.
        texts: Messages that the controller sent.
    """

    def __init__(self, clock: Clock, host: str, port: int, outputs: Mapping[str, str], rate: float) -> None:
        self.endpoint = f"rtde://{host}:{port}"
        self.controller, self.texts = "", 0
        self._address, self._clock = (host, port), clock
        self._outputs, self._rate = outputs, rate
        fields = ((name, *_NUMPY[kind]) for name, kind in outputs.items())
        self._row = np.dtype([("recipe", "u1"), *fields])
        self._stream: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._reading: BackgroundTask | None = None
        self._received = asyncio.Queue[tuple[int, bytes] | Exception](BACKLOG)  # arrival (ns), payload

    async def connect(self) -> None:
        """Connect and request the outputs.

        Raises:
            EndpointError: if the controller does not accept the connection in time.
        """
        recipe = await self._in_time(self._shake_hands(), _NO_ANSWER)
        reading = BackgroundTask(self.endpoint, "the reading of packages", self._read(recipe), endless=False)
        self._reading = reading

    async def receive(self) -> tuple[Times, Rows]:
        """Wait for data; return all unread packages: arrival times and rows with the outputs, (n,), n >= 1.

        Raises:
            EndpointError: if the connection fails, the controller violates the protocol, or no package
                arrives in time.
        """
        arrivals, payloads = zip(*await self._in_time(self._unread(), _NO_DATA), strict=True)
        return np.array(arrivals, np.int64), np.frombuffer(b"".join(payloads), self._row)

    async def close(self) -> None:
        """Close the connection."""
        if self._reading:
            await self._reading.end()
        if self._stream:
            _, writer = self._stream
            writer.transport.abort()
            with suppress(OSError):
                await writer.wait_closed()

    async def _shake_hands(self) -> int:
        """Open the connection; return the number of the granted recipe."""
        self._stream = await asyncio.open_connection(*self._address)
        if await self._ask(Kind.PROTOCOL, PROTOCOL.to_bytes(2, "big")) != b"\1":
            reason = f"the controller does not support RTDE version {PROTOCOL}: update its software"
            raise EndpointError(self.endpoint, reason)
        version = await self._ask(Kind.CONTROLLER)
        if len(version) != _VERSION.size:
            raise RtdeError(f"the controller's version has {len(version)} bytes, must have {_VERSION.size}")
        self.controller = ".".join(map(str, _VERSION.unpack(version)))
        wanted = _RATE.pack(self._rate) + ",".join(self._outputs).encode()
        recipe = granted_recipe(self._outputs, await self._ask(Kind.OUTPUTS, wanted))
        if await self._ask(Kind.START) != b"\1":
            raise RtdeError("the controller refused to start sending")
        return recipe

    async def _ask(self, kind: Kind, payload: bytes = b"") -> bytes:
        assert self._stream
        self._stream[1].write(pack(kind, payload))
        return await self._package(kind)

    async def _package(self, expected: Kind) -> bytes:
        """Return the payload of the next package that is no message."""
        assert self._stream
        reader, _ = self._stream
        while True:
            size, kind = _HEADER.unpack(await reader.readexactly(_HEADER.size))
            if not _HEADER.size <= size <= LARGEST:
                raise RtdeError(f"a package of {size} bytes, must be {_HEADER.size} to {LARGEST}")
            payload = await reader.readexactly(size - _HEADER.size)
            if kind == expected:
                return payload
            if kind != Kind.TEXT:
                raise RtdeError(f"received package {chr(kind)!r}, expected {chr(expected)!r}")
            self._count_text(payload)

    async def _row_of(self, recipe: int) -> bytes:
        """Return the next data package."""
        payload = await self._package(Kind.DATA)
        if payload[:1] != bytes([recipe]) or len(payload) != self._row.itemsize:
            found = f"{len(payload)} bytes for recipe {payload[:1].hex() or 'none'}"
            raise RtdeError(f"data of {found}, not {self._row.itemsize} for {recipe:02x}")
        return payload

    async def _read(self, recipe: int) -> None:
        """Timestamp and store all packages, and at last the error that ends them."""
        try:
            while payload := await self._row_of(recipe):
                await self._received.put((self._clock.now(), payload))
        except Exception as error:  # noqa: BLE001 - raised by `receive`
            await self._received.put(error)

    def _count_text(self, payload: bytes) -> None:
        """Count a message, and log the first `TEXTS` of this connection."""
        self.texts += 1
        if self.texts <= TEXTS:
            log.warning("controller: %s", text(payload))

    async def _unread(self) -> list[tuple[int, bytes]]:
        """Wait for packages; raise the error that ends them after the last one."""
        unread = list[tuple[int, bytes]]()
        while not unread or not self._received.empty():
            match await self._received.get():
                case Exception() as error if unread:
                    self._received.put_nowait(error)
                    break
                case Exception() as error:
                    raise error
                case package:
                    unread.append(package)
        return unread

    async def _in_time(self, awaited: Awaitable[T], late: str) -> T:
        """Wait at most `TIMEOUT`; every failure becomes an EndpointError.

        Its second half begins after a stall of the host, so that packages that wait in the socket are read.
        """
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(None) as limit:
                half = loop.call_later(TIMEOUT / 2, lambda: limit.reschedule(loop.time() + TIMEOUT / 2))
                try:
                    return await awaited
                finally:
                    half.cancel()
        except TimeoutError as error:
            raise EndpointError(self.endpoint, late) from error
        except ConnectionRefusedError as error:
            raise EndpointError(self.endpoint, _REFUSED) from error
        except EOFError as error:
            raise EndpointError(self.endpoint, "the controller closed the connection") from error
        except OSError as error:
            raise EndpointError(self.endpoint, os_error_reason(error)) from error
        except UnicodeError as error:
            raise EndpointError(self.endpoint, "is not a valid name of a host") from error
        except RtdeError as error:
            unknown = "" if self.controller else "is not an RTDE server: "
            raise EndpointError(self.endpoint, f"{unknown}{error}") from error
