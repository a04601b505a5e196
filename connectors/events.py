"""Slip events as CloudEvents 1.0 in structured JSON; docs/reference/asyncapi.json has the schema.

This module does no I/O and reads no clock. Source: https://github.com/cloudevents/spec, v1.0.2.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import starmap
from math import isfinite
from typing import Annotated, Final, Literal, NamedTuple
from urllib.parse import quote, unquote

import numpy as np
from msgspec import Meta

from connectors.documents import INT64, Document, Fraction, Number, decode
from operators.batch import EVERY, SLIP, Faults, Slips
from operators.errors import InputError
from operators.fingertip import CELL_LIMIT
from operators.health import FaultKind
from operators.ports import Json

_JSON: Final = json.JSONEncoder(separators=(",", ":"), allow_nan=False)

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


class _Model(Document, frozen=True):
    id: str
    sha256: str | None


class _Data(Document, frozen=True):
    seq: Number
    epoch: Annotated[str, Meta(max_length=EPOCH_NAME_MAX)]
    finger: str
    state: Literal["onset", "end"]
    p: Fraction | None
    threshold: Fraction | None
    consecutive: Number | None
    sample_time_ns: Annotated[int, Meta(ge=-INT64, le=INT64)]
    latency_ms: float | None
    model: _Model
    degraded: tuple[Fault, ...]
    session: str | None


class _CloudEvent(Document, frozen=True):
    specversion: Literal["1.0"]
    type: str
    source: str
    id: str
    data: _Data


@dataclass(frozen=True, slots=True)
class Event:
    """One onset or end of slip.

    >>> event = Event("lab", "ur10", "0", "s1", 7, onset=True, time=1_500_000_000, probability=0.9, latency=8)
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

    site: str
    rig: str
    finger: str
    epoch: str  # name of the number series of one run
    seq: int  # counts from 1 in each epoch; a gap is a late or lost event
    onset: bool = field(kw_only=True)  # False: the end of a slip
    time: int = field(kw_only=True)  # ns since 1970-01-01 UTC, of the deciding sample
    probability: float | None = field(kw_only=True)  # probability of slip, 0..1; None: unknown
    latency: float | None = field(kw_only=True)  # ms from the sample to the event; None: replay
    threshold: float | None = field(
        default=None, kw_only=True
    )  # probability from which a sample counts as slip; None: unknown
    consecutive: int | None = field(
        default=None, kw_only=True
    )  # samples required for an onset; None: unknown
    model: str = field(default="unknown", kw_only=True)  # identifier of the detector
    sha256: str | None = field(default=None, kw_only=True)  # SHA-256 of the detector's weights; None: unknown
    degraded: tuple[Fault, ...] = field(default=(), kw_only=True)
    session: str | None = field(default=None, kw_only=True)  # run that raised the event; None: unknown

    @property
    def state(self) -> str:
        """``onset`` or ``end``."""
        return "onset" if self.onset else "end"

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
        return encode(
            {
                "specversion": "1.0",
                "type": f"slip.{self.state}.v1",
                "source": "/" + "/".join(quote(part, safe="") for part in (self.site, self.rig, self.finger)),
                "id": self.identifier,
                "time": timestamp(self.time),
                "datacontenttype": "application/json",
                "data": {
                    "seq": self.seq,
                    "epoch": self.epoch,
                    "finger": self.finger,
                    "state": self.state,
                    "p": self.probability,
                    "threshold": self.threshold,
                    "consecutive": self.consecutive,
                    "sample_time_ns": self.time,
                    "latency_ms": self.latency,
                    "model": {"id": self.model, "sha256": self.sha256},
                    "quality": self.quality,
                    "reason": self.reason,
                    "degraded": [fault.values() for fault in self.degraded],
                    "session": self.session,
                },
            }
        )

    @classmethod
    def decode(cls, payload: bytes, where: str = "event") -> "Event":
        """Parse the output of `encode`; ignore unknown fields.

        Raises:
            InputError: naming `where` and the field that is missing or wrong, or if it is larger than 64 KiB.
        """
        event = decode(payload, _CloudEvent, where)
        data, parts = event.data, [unquote(part) for part in event.source.split("/")]
        whole = len(parts) == len(("", "site", "rig", "finger")) and not parts[0] and all(parts[1:])
        if not whole or not "".join(parts).isprintable():
            must_be = "'/<site>/<rig>/<finger>' in printable text"
            raise InputError(where, f"source is {event.source!r:.60}, must be {must_be}")
        for name, found, expected in (
            ("type", event.type, f"slip.{data.state}.v1"),
            ("id", event.id, f"{data.epoch}-{data.seq}"),
            ("data.finger", data.finger, parts[3]),
        ):
            if found != expected:
                raise InputError(where, f"{name} is {found!r:.60}, must be {expected!r}")
        return cls(
            parts[1],
            parts[2],
            parts[3],
            data.epoch,
            data.seq,
            onset=data.state == "onset",
            time=data.sample_time_ns,
            probability=data.p,
            latency=data.latency_ms,
            threshold=data.threshold,
            consecutive=data.consecutive,
            model=data.model.id,
            sha256=data.model.sha256,
            degraded=data.degraded,
            session=data.session,
        )


def quality(probability: float | None, faults: Iterable[Fault]) -> tuple[str, str | None]:
    """Return the quality of a score, and the reason if it is not good.

    It is ``blind`` without a probability; ``doubtful`` while a cell is dead, stuck or drifting; or ``good``.
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
    """Return compact JSON; NaN and infinity become null.

    >>> encode({"p": float("nan"), "rates": [100.0, float("inf")]})
    b'{"p":null,"rates":[100.0,null]}'
    """
    try:
        return _JSON.encode(document).encode()
    except ValueError:  # not finite
        return _JSON.encode(_finite(document)).encode()


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


def _finite(value: Json) -> Json:
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(each) for each in value]
    return value
