"""Slip events as CloudEvents 1.0 in structured JSON; docs/reference/asyncapi.json has the schema.

This module does no I/O and reads no clock. Source: https://github.com/cloudevents/spec, v1.0.2.
"""

import json
from collections.abc import Iterable, Iterator
from itertools import starmap
from math import isfinite
from typing import Annotated, Any, Final, Literal, NamedTuple
from urllib.parse import quote, unquote

import msgspec
import numpy as np
from msgspec import Meta, field
from msgspec.structs import replace

from connectors.documents import INT64, Document, Fraction, Number, decode
from operators.batch import EVERY, SLIP, Faults, Slips
from operators.errors import InputError
from operators.fingertip import CELL_LIMIT
from operators.health import FaultKind
from operators.ports import Json

_LIMIT: Final = FaultKind.SATURATED.name.lower()
CONTENT_TYPE: Final = "application/cloudevents+json"  # CloudEvents MQTT binding 1.0.2, section 3.2

EPOCH_NAME_MAX: Final = 64  # characters


class Fault(Document, frozen=True):
    """A faulty cell, or one at the end of its range, at the time of an event."""

    barometer: Annotated[int, Meta(ge=0, lt=CELL_LIMIT)]  # number of the cell
    kind: str  # kind of fault, such as stuck

    @property
    def limit(self) -> bool:
        """True if the cell works, but its load is beyond its range."""
        return self.kind == _LIMIT


class Model(Document, frozen=True):
    """Detector of an event."""

    id: Annotated[str, Meta(min_length=1)]
    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")] | None = None  # of its weights; None: unknown


class Event(Document, frozen=True, kw_only=True):
    """One onset or end of slip. None: unknown.

    >>> about = {"site": "lab", "rig": "ur10", "finger": "0", "epoch": "s1", "seq": 7, "latency": 8.0}
    >>> event = Event(**about, state="onset", time=1_500_000_000, probability=0.9)
    >>> Event.decode(event.encode()) == event
    True
    >>> import json
    >>> document = json.loads(event.encode())
    >>> document["type"], document["source"], document["id"], document["time"]
    ('slip.onset.v1', '/lab/ur10/0', 's1-7', '1970-01-01T00:00:01.500000000Z')
    >>> data = document["data"]
    >>> data["p"], data["quality"], data["reason"]
    (0.9, 'good', None)
    """

    site: str = ""
    rig: str = ""
    finger: str
    epoch: Annotated[str, Meta(max_length=EPOCH_NAME_MAX)]  # name of the number series of one run
    seq: Number  # counts from 1 in each epoch; a gap is a late or lost event
    state: Literal["onset", "end"]
    time: Annotated[int, Meta(ge=-INT64, le=INT64)] = field(name="sample_time_ns")  # of the deciding sample
    probability: Fraction | None = field(name="p")  # of slip
    latency: float | None = field(name="latency_ms")  # from the sample to the event
    threshold: Fraction | None = None  # probability from which a sample counts as slip
    consecutive: Number | None = None  # samples required for an onset
    model: Model = Model("unknown")
    degraded: tuple[Fault, ...] = ()
    session: str | None = None  # run that raised the event

    @property
    def onset(self) -> bool:
        """False: the end of a slip."""
        return self.state == "onset"

    @property
    def quality(self) -> str:
        """``good``, ``doubtful`` or ``blind``; see `quality`."""
        return quality(self.probability, self.degraded)[0]

    @property
    def reason(self) -> str | None:
        """Reason of a quality other than good, such as ``barometer 2 stuck``."""
        return quality(self.probability, self.degraded)[1]

    @property
    def identifier(self) -> str:
        """Unique identifier, the same in all copies of the event."""
        return f"{self.epoch}-{self.seq}"

    def encode(self) -> bytes:
        """Return the event as a CloudEvent in JSON."""
        data: dict[str, Json] = msgspec.to_builtins(self)
        del data["site"], data["rig"]
        return encode(
            {
                **self.envelope(),
                "time": timestamp(self.time),
                "datacontenttype": "application/json",
                "data": {**data, "quality": self.quality, "reason": self.reason},
            }
        )

    @classmethod
    def decode(cls, payload: bytes, where: str = "event") -> "Event":
        """Parse the output of `encode`; ignore unknown fields.

        Raises:
            InputError: naming `where` and the field that is missing or wrong, or if it is larger than 64 KiB.
        """
        document = decode(payload, _CloudEvent, where)
        parts = document.source.split("/")
        whole = len(parts) == len(("", "site", "rig", "finger")) and all(parts[1:])
        if not whole or not unquote(document.source).isprintable():
            must_be = "'/<site>/<rig>/<finger>' in printable text"
            raise InputError(where, f"source is {document.source!r:.60}, must be {must_be}")
        event = replace(document.data, site=unquote(parts[1]), rig=unquote(parts[2]))
        for name, expected in event.envelope().items():
            if (found := getattr(document, name)) != expected:
                raise InputError(where, f"{name} is {found!r:.60}, must be {expected!r}")
        return event

    def envelope(self) -> dict[str, str]:
        """Return the attributes of the CloudEvent that follow from the data."""
        return {
            "specversion": "1.0",
            "type": f"slip.{self.state}.v1",
            "source": "/" + "/".join(quote(part, safe="") for part in (self.site, self.rig, self.finger)),
            "id": self.identifier,
        }


class _CloudEvent(Document, frozen=True):
    specversion: str
    type: str
    source: str
    id: str
    data: Event


def quality(probability: float | None, faults: Iterable[Fault]) -> tuple[str, str | None]:
    """Return the quality of a score, and the reason if it is not good.

    It is ``blind`` without a probability; ``doubtful`` while a cell is dead or stuck; or ``good``.
    A cell at the end of its range leaves it good: load alone causes it, and tcn tolerates it.

    >>> quality(0.9, [Fault(2, "stuck"), Fault(3, "saturated")])
    ('doubtful', 'barometer 2 stuck')
    """
    if probability is None or not isfinite(probability):
        return "blind", "no probability"
    ordered = sorted(faults, key=lambda fault: fault.barometer)
    reasons = [f"barometer {fault.barometer} {fault.kind}" for fault in ordered if not fault.limit]
    return ("doubtful", ", ".join(reasons)) if reasons else ("good", None)


def encode(document: Json) -> bytes:
    """Return compact JSON; NaN and infinity become null, text that is not UTF-8 question marks.

    >>> encode({"p": float("nan"), "rates": [100.0, float("inf")]})
    b'{"p":null,"rates":[100.0,null]}'
    """
    try:
        return msgspec.json.encode(document, enc_hook=_plain)
    except UnicodeEncodeError:  # a file name that is not UTF-8
        text = json.dumps(document, ensure_ascii=False, default=_plain).encode(errors="replace")
        return msgspec.json.encode(json.loads(text))


def _plain(value: Any) -> Any:
    """Return a number or array of numpy, or another sequence, as Python's own."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else list(value)


def timestamp(time: int) -> str:
    """Return a time (ns since 1970) in the format of RFC 3339, UTC.

    >>> timestamp(1_600_000_000_123_456_789)
    '2020-09-13T12:26:40.123456789Z'
    """
    return f"{np.datetime64(time, 'ns')}Z"


def finger_name(finger: int) -> str:
    """Return the name of a fingertip in topics and events.

    >>> finger_name(2), finger_name(EVERY)
    ('2', 'every')
    """
    return "every" if finger == EVERY else str(finger)


class Slip(NamedTuple):
    """One row of `Slips`."""

    time: int  # ns
    onset: bool  # False: end
    probability: float


def slips(batch: Slips) -> Iterator[Slip]:
    """Yield the rows of a batch.

    >>> time = np.array([5])
    >>> next(slips(Slips(time, np.array([1], np.int8), time, time / 10)))
    Slip(time=5, onset=True, probability=0.5)
    """
    columns = batch.time.tolist(), (batch.state == SLIP).tolist(), batch.probability.tolist()
    return starmap(Slip, zip(*columns, strict=True))


def faults(batch: Faults) -> Iterator[tuple[int, Fault, bool]]:
    """Yield time (ns), fault, and True for its beginning or False for its end, for each row of a batch."""
    rows = (batch.time.tolist(), batch.barometer.tolist(), batch.kind.tolist(), batch.active.tolist())
    for time, barometer, kind, active in zip(*rows, strict=True):
        yield time, Fault(barometer, FaultKind(kind).name.lower()), active
