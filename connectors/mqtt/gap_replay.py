"""Replay of missed events on request: request, answer, and the queue of requests to a rig."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from connectors.events import CONTENT_TYPE, encode
from connectors.fields import Fields
from connectors.mqtt.broker import Message
from operators.errors import EndpointError, InputError
from operators.ports import Json

if TYPE_CHECKING:
    from connectors.mqtt.outbox import Outbox

log = logging.getLogger("slipflow")

TOPIC_MAX = 256  # characters
PENDING_MAX = 32  # requests; a client without an answer repeats its request
SLICE = 64  # events per answer; the client requests the rest


@dataclass(frozen=True, slots=True)
class GapRequest:
    """Request for events `first` to `last` of an epoch, to be sent to the topic `reply_to`.

    >>> request = GapRequest("ab", 3, 9, "slip/v1/lab/ur10/replay/me")
    >>> request.encode()
    b'{"epoch":"ab","from":3,"to":9,"reply_to":"slip/v1/lab/ur10/replay/me"}'
    >>> GapRequest.decode(request.encode(), "slip/v1/lab/ur10") == request
    True
    """

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

    >>> answer = GapAnswer("ab", 3, 9, ((3, 4), (7, 7)))
    >>> answer.encode()
    b'{"epoch":"ab","from":3,"to":9,"missing":[[3,4],[7,7]]}'
    >>> GapAnswer.read(Fields.parse(answer.encode(), "answer")) == answer
    True
    """

    epoch: str
    first: int
    last: int
    missing: tuple[tuple[int, int], ...]

    def encode(self) -> bytes:
        """Return the answer as JSON."""
        missing: list[Json] = [[first, last] for first, last in self.missing]
        return encode({"epoch": self.epoch, "from": self.first, "to": self.last, "missing": missing})

    @classmethod
    def read(cls, fields: Fields) -> "GapAnswer":
        """Read an answer from a JSON object.

        Raises:
            InputError: naming the field that is missing or wrong.
        """
        first = fields.integer("from")
        last = fields.integer("to", first)
        missing = tuple(fields.ranges("missing"))
        if any(not first <= low <= high <= last for low, high in missing):
            raise InputError(fields.where, f"missing exceeds the range {first} to {last}")
        return cls(fields.text("epoch"), first, last, missing)


class GapReplies:
    """Pending requests to one rig, which are answered in turn, one slice of events at a time."""

    def __init__(self, outbox: "Outbox", topic: str) -> None:
        """Prepare to answer for the rig at `topic` from `outbox`."""
        self._outbox, self._topic = outbox, topic
        self._pending: dict[GapRequest, None] = {}  # in order of arrival
        self._malformed_logged = False

    def request(self, payload: bytes) -> None:
        """Queue a request; ignore malformed ones, and log the first of them."""
        try:
            request = GapRequest.decode(payload, self._topic)
        except InputError as error:
            if not self._malformed_logged:
                log.warning("ignoring malformed gap request (further ones suppressed): %s", error)
            self._malformed_logged = True
            return
        if len(self._pending) < PENDING_MAX:
            self._pending[request] = None

    def clear(self) -> None:
        """Drop all requests after a lost connection; the clients repeat them."""
        self._pending.clear()

    async def next(self) -> list[Message]:
        """Return the answer to the next request, with at most `SLICE` events; [] if there is none."""
        while self._pending:
            request = next(iter(self._pending))
            del self._pending[request]
            try:
                found, last = await self._outbox.between(request.epoch, request.first, request.last, SLICE)
            except EndpointError:
                continue  # unreadable now, but not lost: the client repeats its request
            if last >= request.first:  # else the numbers are not used yet
                missing = _missing(request.first, last, [entry.seq for entry in found])
                closing = GapAnswer(request.epoch, request.first, last, missing).encode()
                events = (entry.payload for entry in found)
                return [
                    *(
                        Message(request.reply_to, each, retain=False, content_type=CONTENT_TYPE)
                        for each in events
                    ),
                    Message(request.reply_to, closing, retain=False),
                ]
        return []


def _missing(first: int, last: int, found: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Return the ranges of `first` to `last` that are not among the sorted numbers `found`.

    >>> _missing(1, 9, [3, 4, 9])
    ((1, 2), (5, 8))
    """
    before = pairwise([first - 1, *found, last + 1])
    return tuple((low + 1, high - 1) for low, high in before if high > low + 1)
