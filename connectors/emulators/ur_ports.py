"""What listens on the ports of a UR controller: one object per connection."""

import asyncio
import logging
import socket
import struct
from collections import deque
from collections.abc import Callable, Mapping
from typing import Final, cast

from connectors.emulators.dashboard_server import FAREWELL, GREETING, answer
from connectors.emulators.ur_control_box import ControlBox
from connectors.emulators.ur_variables import INPUTS, OUTPUTS
from connectors.ur.rtde import (
    PROTOCOL,
    Kind,
    Package,
    Packages,
    Recipe,
    RtdeError,
    names,
    outputs_asked,
    pack,
)

log = logging.getLogger("slipflow")

UNREAD: Final = 1 << 16  # bytes that a client may leave unread until it is dropped
HELD: Final = 1 << 15  # packages, a minute, that can be held up; then the oldest are lost
SCRIPT_LARGEST: Final = 1 << 20  # bytes of an upload
LINE_LARGEST: Final = 4096  # bytes


class Connection(asyncio.Protocol):
    """A client of any port.

    Args:
        box: The controller.
        everybody: Where it is listed while it is connected.

    Attributes:
        lost: Set when it is over.
    """

    def __init__(self, box: ControlBox, everybody: "set[Connection]") -> None:
        self.box, self._everybody = box, everybody
        self._transport: asyncio.Transport | None = None
        self.lost = asyncio.Event()

    @property
    def transport(self) -> asyncio.Transport:
        """Its socket, once it is connected."""
        assert self._transport
        return self._transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Be listed."""
        self._transport = cast("asyncio.Transport", transport)
        self._everybody.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Be listed no more."""
        del exc
        self._everybody.discard(self)
        self.lost.set()

    def reset(self) -> None:
        """End it without a farewell: the client's socket is reset."""
        linger = struct.pack("ii", 1, 0)
        self.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        self.transport.abort()


class RtdeConnection(Connection):
    """A client of the RTDE port.

    Attributes:
        held: What is not sent while it is held up; None: it is not.
        gone: The peer is out of reach, and neither side knows.
    """

    def __init__(self, box: ControlBox, everybody: set[Connection]) -> None:
        super().__init__(box, everybody)
        self._packages, self._started = Packages(), False
        self._outputs: Recipe | None = None
        self._every = 1  # cycles from package to package
        self._inputs: dict[int, Recipe] = {}
        self.held: deque[bytes] | None = None
        self.gone = False

    @property
    def inputs(self) -> set[str]:
        """The input variables that it writes, and nobody else may."""
        return {name for recipe in self._inputs.values() for name in recipe.names}

    def data_received(self, data: bytes) -> None:
        """Answer what is asked, take what is written; who does not keep to the protocol is dropped."""
        if self.gone:
            return
        try:
            for package in self._packages.feed(data):
                self._take(package)
        except RtdeError as error:
            log.warning("a client of RTDE is dropped: %s", error)
            self.transport.abort()

    def hold(self) -> None:
        """Hold up what is sent from now on."""
        self.held = deque(self.held or (), HELD)

    def release(self, *, burst: bool) -> None:
        """Send again; with a `burst` of what was held up, else that is lost."""
        held, self.held = self.held or (), None
        if burst and not self.gone:
            self.transport.write(b"".join(held))

    def tell(self) -> None:
        """Send what the newest cycle showed, if it is due."""
        if self._started and self._outputs and self.box.cycles % self._every == 0:
            self.send(Kind.DATA, self._outputs.pack(self.box.values(self._outputs.names)))

    def send(self, kind: Kind, payload: bytes) -> None:
        """Send a package, unless it is held up; a client that does not read is dropped."""
        if self.held is not None:
            self.held.append(pack(kind, payload))
        elif not (self.gone or self.transport.is_closing()):
            self.transport.write(pack(kind, payload))
            if self.transport.get_write_buffer_size() > UNREAD:
                log.warning("a client of RTDE does not read: it is dropped")
                self.transport.abort()

    def _take(self, package: Package) -> None:
        kind, payload = package
        match kind:
            case Kind.PROTOCOL:
                self.send(Kind.PROTOCOL, bytes([int.from_bytes(payload, "big") == PROTOCOL]))
            case Kind.CONTROLLER:
                self.send(Kind.CONTROLLER, self.box.version.payload)
            case Kind.OUTPUTS:
                self.send(Kind.OUTPUTS, self._grant_outputs(payload))
            case Kind.INPUTS:
                self.send(Kind.INPUTS, self._grant_inputs(names(payload)))
            case Kind.START:
                self._started = self._outputs is not None
                self.send(Kind.START, bytes([self._started]))
            case Kind.PAUSE:
                self._started = False
                self.send(Kind.PAUSE, b"\1")
            case Kind.DATA:
                recipe = self._inputs.get(payload[0] if payload else 0)
                if recipe is None:
                    raise RtdeError(f"data for recipe {payload[:1].hex() or 'none'}")
                self.box.write(dict(zip(recipe.names, recipe.unpack(payload), strict=True)))
            case Kind.TEXT:
                log.info("a client of RTDE says %r", payload[:255])
            case _:
                raise RtdeError(f"a package {chr(kind)!r}")

    def _grant_outputs(self, payload: bytes) -> bytes:
        rate, wanted = outputs_asked(payload)
        types = _types(wanted, OUTPUTS)
        if "NOT_FOUND" in types or not wanted or not 0 < rate <= self.box.rate:
            return b"\0" + ",".join(types).encode()
        self._outputs, self._every = Recipe(1, wanted, types), round(self.box.rate / rate)
        return self._outputs.answer

    def _grant_inputs(self, wanted: tuple[str, ...]) -> bytes:
        others = [
            other for other in self._everybody if isinstance(other, RtdeConnection) and other is not self
        ]
        taken = {name: "IN_USE" for other in others for name in other.inputs}
        types, number = _types(wanted, {**INPUTS, **taken}), len(self._inputs) + 1
        if {"NOT_FOUND", "IN_USE"} & set(types) or not wanted or number > 255:  # noqa: PLR2004 - a uint8
            return b"\0" + ",".join(types).encode()
        self._inputs[number] = Recipe(number, wanted, types)
        return self._inputs[number].answer


class TextConnection(Connection):
    """A client that sends text."""

    largest = LINE_LARGEST

    def __init__(self, box: ControlBox, everybody: set[Connection]) -> None:
        super().__init__(box, everybody)
        self._text = ""

    def data_received(self, data: bytes) -> None:
        """Take the lines that are complete; who sends too much without an end is dropped."""
        self._text = self.take(self._text + data.decode("utf-8", "replace"))
        if len(self._text) > self.largest:
            log.warning("a client sends text without an end: it is dropped")
            self.transport.abort()

    def take(self, text: str) -> str:
        """Take what is complete of a text; give the rest."""
        raise NotImplementedError


class ScriptConnection(TextConnection):
    """A client that uploads programs: from a line that begins with ``def`` to one that is ``end``."""

    largest = SCRIPT_LARGEST

    def take(self, text: str) -> str:
        """Run the programs that are complete."""
        *complete, rest = text.split("\nend\n")
        for each in complete:
            self.box.run_script(each)
        return rest


class DashboardConnection(TextConnection):
    """A client of the dashboard."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet."""
        super().connection_made(transport)
        self._say(GREETING)

    def take(self, text: str) -> str:
        """Answer each line."""
        *lines, rest = text.split("\n")
        for line in lines:
            said = answer(self.box, line)
            self._say(said)
            if said == FAREWELL:
                self.transport.close()
        return rest

    def _say(self, line: str) -> None:
        self.transport.write(f"{line}\n".encode())


Listener = Callable[[ControlBox, set[Connection]], Connection]


def _types(wanted: tuple[str, ...], known: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(known.get(name, "NOT_FOUND") for name in wanted)
