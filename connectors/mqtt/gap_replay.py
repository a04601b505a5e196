"""Replay of missed events on request: request, answer, and the queue of requests to a rig."""

import logging
from itertools import pairwise
from math import inf
from typing import TYPE_CHECKING

import msgspec

from connectors.documents import Document, Number, decode
from connectors.events import CONTENT_TYPE
from connectors.mqtt.broker import Message
from operators.errors import InputError

if TYPE_CHECKING:
    from connectors.mqtt.outbox import Outbox

log = logging.getLogger("slipflow")

TOPIC_MAX = 256  # characters
PENDING_MAX = 32  # requests; a client without an answer repeats its request
SLICE = 64  # events per answer; the client requests the rest
PAUSE = 0.05  # s, from one answer to the next, so that no number of requests delays new events


class _Numbers(Document, frozen=True, rename={"first": "from", "last": "to"}):
    """Numbers `first` to `last` of an epoch."""

    epoch: str
    first: Number
    last: Number

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.last < self.first:
            raise ValueError(f"`to` is {self.last}, must be an integer from {self.first}")

    def encode(self) -> bytes:
        """Return the document as JSON."""
        return msgspec.json.encode(self)


class GapRequest(_Numbers, frozen=True):
    """Request for events `first` to `last` of an epoch, to be sent to the topic `reply_to`."""

    reply_to: str

    @classmethod
    def decode(cls, payload: bytes, topic: str) -> "GapRequest":
        """Parse a request to the rig at `topic`; `reply_to` must be below the ``replay`` topic of the rig.

        Raises:
            InputError: naming the field that is missing or wrong.
        """
        request = decode(payload, cls, f"{topic}/replay/request")
        name = request.reply_to.removeprefix(f"{topic}/replay/")
        own = request.reply_to == f"{topic}/replay/{name}" and name not in ("", "request", "event")
        if not own or set(name) & set("/+#") or len(request.reply_to) > TOPIC_MAX:
            reason = f"reply_to is {request.reply_to!r:.60}, must be {topic}/replay/<name>"
            raise InputError(f"{topic}/replay/request", reason)
        return request


class GapAnswer(_Numbers, frozen=True):
    """Closing answer: events `first` to `last` were sent, except `missing`, which are no longer kept.

    `last` may be less than requested; the client requests the rest again.
    """

    missing: tuple[tuple[Number, Number], ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(not self.first <= low <= high <= self.last for low, high in self.missing):
            raise ValueError(f"`missing` exceeds the range {self.first} to {self.last}")


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
            closing = GapAnswer(request.epoch, request.first, last, tuple(missing)).encode()
            topic = request.reply_to
            events = [Message(topic, each.payload, retain=False, content_type=CONTENT_TYPE) for each in found]
            return [*events, Message(topic, closing, retain=False)]
        return []
