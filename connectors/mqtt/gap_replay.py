"""Replay of missed events on request: request, answer, and the queue of requests to a rig."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from typing import TYPE_CHECKING

from connectors.events import CONTENT_TYPE, encode
from connectors.fields import Fields
from connectors.mqtt.broker import Message
from operators.errors import InputError

if TYPE_CHECKING:
    from connectors.mqtt.outbox import Outbox

log = logging.getLogger("slipflow")

TOPIC_MAX = 256  # characters
PENDING_MAX = 32  # requests; a client without an answer repeats its request
SLICE = 64  # events per answer; the client requests the rest
PAUSE = 0.05  # s, from one answer to the next, so that no number of requests delays new events


@dataclass(frozen=True, slots=True)
class GapRequest:
    """Request for events `first` to `last` of an epoch, to be sent to the topic `reply_to`."""

    epoch: str
    first: int
    last: int
    reply_to: str

    def encode(self) -> bytes:
        """Return the request as JSON."""
        return encode({"epoch": self.epoch, "from": self.first, "to": self.last, "reply_to": self.reply_to})

    @classmethod
    def decode(cls, payload: bytes, topic: str) -> "GapRequest":
        """Parse a request to the rig at `topic`; `reply_to` must be below the ``replay`` topic of the rig.

        Raises:
            InputError: naming the field that is missing or wrong.
        """
        fields = Fields.parse(payload, f"{topic}/replay/request")
        first = fields.integer("from")
        request = cls(fields.text("epoch"), first, fields.integer("to", first), fields.text("reply_to"))
        name = request.reply_to.removeprefix(f"{topic}/replay/")
        own = request.reply_to == f"{topic}/replay/{name}" and name not in ("", "request", "event")
        if not own or set(name) & set("/+#") or len(request.reply_to) > TOPIC_MAX:
            fields.fail("reply_to", f"{topic}/replay/<name>")
        return request


@dataclass(frozen=True, slots=True)
class GapAnswer:
    """Closing answer: events `first` to `last` were sent, except `missing`, which are no longer kept.

    `last` may be less than requested; the client requests the rest again.
    """

    epoch: str
    first: int
    last: int
    missing: Sequence[tuple[int, int]]

    def encode(self) -> bytes:
        """Return the answer as JSON."""
        missing = [list(each) for each in self.missing]
        return encode({"epoch": self.epoch, "from": self.first, "to": self.last, "missing": missing})

    @classmethod
    def read(cls, fields: Fields) -> "GapAnswer":
        """Read an answer from a JSON object.

        Raises:
            InputError: naming the field that is missing or wrong.
        """
        first = fields.integer("from")
        last, missing = fields.integer("to", first), fields.ranges("missing")
        if any(not first <= low <= high <= last for low, high in missing):
            raise InputError(fields.where, f"missing exceeds the range {first} to {last}")
        return cls(fields.text("epoch"), first, last, missing)


class GapReplies:
    """Pending requests to one rig, which are answered in turn, one slice of events at a time."""

    def __init__(self, outbox: "Outbox", topic: str) -> None:
        """Prepare to answer for the rig at `topic` from `outbox`."""
        self._outbox, self._topic = outbox, topic
        self._pending: dict[GapRequest, None] = {}  # in order of arrival
        self._earliest = 0.0  # loop time, s, of the next answer
        self._malformed_logged = False

    @property
    def due(self) -> float:
        """Loop time (s) of the next answer; infinite if there is no request."""
        return self._earliest if self._pending else inf

    def request(self, payload: bytes) -> None:
        """Queue a request if there is room; ignore malformed ones, and log the first of them."""
        if len(self._pending) >= PENDING_MAX:
            return
        try:
            request = GapRequest.decode(payload, self._topic)
        except InputError as error:
            if not self._malformed_logged:
                log.warning("ignoring malformed gap request (further ones suppressed): %s", error)
            self._malformed_logged = True
            return
        self._pending[request] = None

    def clear(self) -> None:
        """Drop all requests after a lost connection; the clients repeat them."""
        self._pending.clear()

    async def next(self, now: float) -> list[Message]:
        """Return the next answer that is due at the loop time `now`, with at most `SLICE` events; else []."""
        while now >= self.due:
            request = next(iter(self._pending))
            del self._pending[request]
            try:
                found, last = await self._outbox.between(request.epoch, request.first, request.last, SLICE)
            except OSError:
                continue  # unreadable now, but not lost: the client repeats its request
            if last < request.first:
                continue  # the numbers are not used yet
            before = pairwise([request.first - 1, *(entry.seq for entry in found), last + 1])
            missing = [(low + 1, high - 1) for low, high in before if high > low + 1]
            self._earliest = now + PAUSE
            closing = GapAnswer(request.epoch, request.first, last, missing).encode()
            return [
                *(
                    Message(request.reply_to, each.payload, retain=False, content_type=CONTENT_TYPE)
                    for each in found
                ),
                Message(request.reply_to, closing, retain=False),
            ]
        return []
