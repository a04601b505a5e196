"""A client's half of an RTDE connection: from the handshake to the values. No I/O."""

import logging
from collections.abc import Iterator, Sequence

from connectors.ur.rtde import PROTOCOL, Kind, Packages, Recipe, RtdeError, Version, ask_outputs, pack, text

log = logging.getLogger("slipflow")


class Subscription:
    """A client's half of a connection: it asks for outputs at a rate and then is given them.

    Send `outgoing` first, and whenever it is not empty; what is sent is to be cleared.

    Attributes:
        outgoing: Bytes to be sent.
        controller: Its version, once it is known.
        recipe: Once it is granted.
        started: Whether the controller said that it sends.
    """

    def __init__(self, outputs: Sequence[str], rate: float) -> None:
        self._outputs, self._rate = outputs, rate
        self._packages = Packages()
        self._awaited = Kind.PROTOCOL
        self.outgoing = bytearray(pack(Kind.PROTOCOL, PROTOCOL.to_bytes(2, "big")))
        self.controller: Version | None = None
        self.recipe: Recipe | None = None
        self.started = False

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Take what was read; give the payloads of the data packages, checked; to be iterated to its end.

        Raises:
            RtdeError: if the controller refuses, or does not keep to the protocol.
        """
        for kind, payload in self._packages.feed(data):
            if kind == Kind.DATA and self.started and self.recipe:
                self.recipe.check(payload)
                yield payload
            elif kind == Kind.TEXT:
                log.warning("controller: %s", text(payload))
            elif kind == self._awaited and not self.started:
                self._answered(payload)
            else:
                raise RtdeError(f"a package {chr(kind)!r} where {chr(self._awaited)!r} was due")

    def _answered(self, payload: bytes) -> None:
        if self._awaited is Kind.PROTOCOL:
            if payload != b"\1":
                raise RtdeError(
                    f"the controller does not speak version {PROTOCOL} of RTDE: update its software"
                )
            self._ask(Kind.CONTROLLER)
        elif self._awaited is Kind.CONTROLLER:
            self.controller = Version.read(payload)
            self._ask(Kind.OUTPUTS, ask_outputs(self._rate, self._outputs))
        elif self._awaited is Kind.OUTPUTS:
            self.recipe = Recipe.granted(self._outputs, payload)
            self._ask(Kind.START)
        else:
            if payload != b"\1":
                raise RtdeError("the controller refused to start to send")
            self.started, self._awaited = True, Kind.DATA

    def _ask(self, kind: Kind, payload: bytes = b"") -> None:
        self._awaited = kind
        self.outgoing += pack(kind, payload)
