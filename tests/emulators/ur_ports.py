"""Ports of an emulated UR controller: one object per connection."""

import asyncio
import logging
import socket
import struct
from collections import deque
from collections.abc import Mapping
from typing import Final, cast

from connectors.ur.rtde import PROTOCOL, Kind, Package, Packages, RtdeError, names, pack
from tests.emulators.rtde_recipe import Recipe, Request, outputs_asked, version_payload
from tests.emulators.ur_control_box import FAREWELL, GREETING, INPUTS, OUTPUTS, ControlBox, answer

log = logging.getLogger("slipflow")

UNREAD_LIMIT: Final = 1 << 16  # bytes that a client may leave unread before it is disconnected
SCRIPT_LIMIT: Final = 1 << 20  # bytes of an uploaded script
LINE_LIMIT: Final = 4096  # bytes of a dashboard line
HELD: Final = 1 << 15  # packages, a minute; then the oldest are lost
MAX_RECIPES: Final = 255  # a recipe number is a uint8


class Connection(asyncio.Protocol):
    """A client connection on one port.

    Args:
        box: The controller.
        connections: Set that contains this connection while it is open.

    Attributes:
        lost: Event, set when the connection has ended.
    """

    def __init__(self, box: ControlBox, connections: "set[Connection]") -> None:
        self.box, self._connections = box, connections
        self._transport: asyncio.Transport | None = None
        self.lost = asyncio.Event()

    @property
    def transport(self) -> asyncio.Transport:
        """Transport of the socket, once connected."""
        assert self._transport
        return self._transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Add this connection to the open connections."""
        self._transport = cast("asyncio.Transport", transport)
        self._connections.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove this connection from the open connections."""
        del exc
        self._connections.discard(self)
        self.lost.set()


class RtdeConnection(Connection):
    """A client connection on the RTDE port, which can be held up, reset, or lost without a sign (`gone`)."""

    def __init__(self, box: ControlBox, connections: set[Connection], *, gone: bool = False) -> None:
        super().__init__(box, connections)
        self.gone = gone
        self._held: deque[bytes] | None = None
        self._packages, self._started = Packages(), False
        self._outputs: Recipe | None = None
        self._interval = 1  # cycles between packages
        self._inputs: dict[int, Recipe] = {}

    @property
    def inputs(self) -> set[str]:
        """Input variables reserved for this client."""
        return {name for recipe in self._inputs.values() for name in recipe.names}

    def data_received(self, data: bytes) -> None:
        """Handle packages; disconnect a client that violates the protocol."""
        if self.gone:
            return
        try:
            for package in self._packages.feed(data):
                self._handle(package)
        except RtdeError as error:
            log.warning("disconnecting an RTDE client: %s", error)
            self.transport.abort()

    def publish(self) -> None:
        """Send the outputs of the latest cycle if they are due."""
        if self._started and self._outputs and self.box.cycles % self._interval == 0:
            self.send(Kind.DATA, self._outputs.pack(self.box.values(self._outputs.names)))

    def hold(self) -> None:
        """Hold up all packages."""
        self._held = deque(self._held or (), HELD)

    def release(self, *, burst: bool) -> None:
        """Send again, with a burst of what was held up; else that is lost."""
        held, self._held = self._held or (), None
        if burst and not self.gone:
            self.transport.write(b"".join(held))

    def reset(self) -> None:
        """Reset the connection."""
        linger = struct.pack("ii", 1, 0)  # close sends RST
        self.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        self.transport.abort()

    def send(self, kind: int, payload: bytes) -> None:
        """Send a package; disconnect a client that does not read."""
        if self._held is not None:
            self._held.append(pack(kind, payload))
        elif not self.gone and not self.transport.is_closing():
            self.transport.write(pack(kind, payload))
            if self.transport.get_write_buffer_size() > UNREAD_LIMIT:
                log.warning("disconnecting an RTDE client that does not read")
                self.transport.abort()

    def _handle(self, package: Package) -> None:
        kind, payload = package
        match kind:
            case Kind.PROTOCOL:
                self.send(Kind.PROTOCOL, bytes([int.from_bytes(payload, "big") == PROTOCOL]))
            case Kind.CONTROLLER:
                self.send(Kind.CONTROLLER, version_payload(self.box.version))
            case Kind.OUTPUTS:
                self.send(Kind.OUTPUTS, self._grant_outputs(payload))
            case Request.INPUTS:
                self.send(Request.INPUTS, self._grant_inputs(names(payload)))
            case Kind.START:
                self._started = self._outputs is not None
                self.send(Kind.START, bytes([self._started]))
            case Request.PAUSE:
                self._started = False
                self.send(Request.PAUSE, b"\1")
            case Kind.DATA:
                recipe = self._inputs.get(payload[0] if payload else 0)
                if recipe is None:
                    raise RtdeError(f"data for unknown recipe {payload[:1].hex() or '(none)'}")
                self.box.write(dict(zip(recipe.names, recipe.unpack(payload), strict=True)))
            case Kind.TEXT:
                log.info("RTDE client: %r", payload[:255])
            case _:
                raise RtdeError(f"unexpected package {chr(kind)!r}")

    def _grant_outputs(self, payload: bytes) -> bytes:
        rate, wanted = outputs_asked(payload)
        types = _types(wanted, OUTPUTS)
        if "NOT_FOUND" in types or not wanted or not 0 < rate <= self.box.rate:
            return b"\0" + ",".join(types).encode()
        self._outputs, self._interval = Recipe(1, wanted, types), round(self.box.rate / rate)
        return self._outputs.answer

    def _grant_inputs(self, wanted: tuple[str, ...]) -> bytes:
        others = [
            other for other in self._connections if isinstance(other, RtdeConnection) and other is not self
        ]
        taken = {name: "IN_USE" for other in others for name in other.inputs}
        types, number = _types(wanted, {**INPUTS, **taken}), len(self._inputs) + 1
        if {"NOT_FOUND", "IN_USE"} & set(types) or not wanted or number > MAX_RECIPES:
            return b"\0" + ",".join(types).encode()
        self._inputs[number] = Recipe(number, wanted, types)
        return self._inputs[number].answer


class TextConnection(Connection):
    """A client connection that receives text."""

    limit = LINE_LIMIT  # bytes of incomplete text

    def __init__(self, box: ControlBox, connections: set[Connection]) -> None:
        super().__init__(box, connections)
        self._text = ""

    def data_received(self, data: bytes) -> None:
        """Handle complete text; disconnect a client that exceeds the limit without a terminator."""
        self._text = self.take(self._text + data.decode("utf-8", "replace"))
        if len(self._text) > self.limit:
            log.warning(
                "disconnecting a client that sent %d characters without a terminator", len(self._text)
            )
            self.transport.abort()

    def take(self, text: str) -> str:
        """Handle the complete parts of a text and return the incomplete rest."""
        raise NotImplementedError


class ScriptConnection(TextConnection):
    """A client connection on the script port; a program ends with a line ``end``."""

    limit = SCRIPT_LIMIT

    def take(self, text: str) -> str:
        """Run complete programs."""
        *complete, rest = text.split("\nend\n")
        for script in complete:
            self.box.run_script(script)
        return rest


class DashboardConnection(TextConnection):
    """A client connection on the dashboard port."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send the greeting."""
        super().connection_made(transport)
        self._send(GREETING)

    def take(self, text: str) -> str:
        """Answer each line."""
        *lines, rest = text.split("\n")
        for line in lines:
            reply = answer(self.box, line)
            self._send(reply)
            if reply == FAREWELL:
                self.transport.close()
        return rest

    def _send(self, line: str) -> None:
        self.transport.write(f"{line}\n".encode())


def _types(wanted: tuple[str, ...], known: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(known.get(name, "NOT_FOUND") for name in wanted)
