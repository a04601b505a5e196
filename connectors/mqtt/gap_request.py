"""Asking a rig for events that did not come, and what it answers at the end: JSON on the wire, both ways."""

from dataclasses import dataclass

from connectors.events import encode
from connectors.fields import Fields
from operators.errors import InputError
from operators.ports import Json

LONGEST = 256  # characters of a topic


@dataclass(frozen=True, slots=True)
class GapRequest:
    """Asks for events `first` to `last` of an epoch, to be sent to the topic `reply_to`.

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
        """As JSON."""
        return encode({"epoch": self.epoch, "from": self.first, "to": self.last, "reply_to": self.reply_to})

    @classmethod
    def decode(cls, payload: bytes, topic: str) -> "GapRequest":
        """Read a request to the rig at `topic`, which answers below its own ``replay`` only.

        Raises:
            InputError: naming the field that is missing or wrong.
        """
        fields = Fields.parse(payload, f"{topic}/replay/request")
        first = fields.whole("from")
        request = cls(fields.text("epoch"), first, fields.whole("to", first), fields.text("reply_to"))
        name = request.reply_to.removeprefix(f"{topic}/replay/")
        own = request.reply_to == f"{topic}/replay/{name}" and name not in ("", "request", "event")
        if not own or set(name) & set("/+#") or len(request.reply_to) > LONGEST:
            fields.fail("reply_to", f"{topic}/replay/<name>")
        return request


@dataclass(frozen=True, slots=True)
class GapAnswer:
    """Closes an answer: of events `first` to `last` all were sent but those in `missing`, which are not kept.

    `last` may be less than what was asked for: then the rest is to be asked for anew.

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
        """As JSON."""
        missing: list[Json] = [[first, last] for first, last in self.missing]
        return encode({"epoch": self.epoch, "from": self.first, "to": self.last, "missing": missing})

    @classmethod
    def read(cls, fields: Fields) -> "GapAnswer":
        """Read an answer.

        Raises:
            InputError: naming the field that is missing or wrong.
        """
        first = fields.whole("from")
        last = fields.whole("to", first)
        missing = tuple(fields.ranges("missing"))
        if any(not first <= low <= high <= last for low, high in missing):
            raise InputError(fields.where, f"missing reaches beyond {first} to {last}")
        return cls(fields.text("epoch"), first, last, missing)
