"""Slip events as CloudEvents 1.0 in structured JSON; docs/reference/asyncapi.json has the schema.

This module does no I/O and reads no clock. Source: https://github.com/cloudevents/spec, v1.0.2.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import starmap
from math import isfinite
from typing import Final, NamedTuple
from urllib.parse import quote, unquote

import numpy as np

from connectors.fields import INT64, Fields
from operators.batch import EVERY, SLIP, Faults, Slips
from operators.fingertip import CELL_LIMIT
from operators.health import FaultKind
from operators.ports import Json

_JSON: Final = json.JSONEncoder(separators=(",", ":"), allow_nan=False)

_LIMIT: Final = FaultKind.SATURATED.name.lower()
CONTENT_TYPE: Final = "application/cloudevents+json"  # CloudEvents MQTT binding 1.0.2, section 3.2


@dataclass(frozen=True, slots=True)
class Fault:
    """A faulty cell, or one at the end of its range, at the time of an event."""

    barometer: int  # number of the cell
    kind: str  # kind of fault, such as stuck

    @property
    def limit(self) -> bool:
        """True if the cell works, but its load is beyond its range."""
        return self.kind == _LIMIT


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
                    "degraded": [asdict(fault) for fault in self.degraded],
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
        return cls.read(Fields.parse(payload, where))

    @classmethod
    def read(cls, event: Fields) -> "Event":
        """Read an event from a JSON object.

        Raises:
            InputError: naming the field that is missing or wrong.
        """
        data = event.object("data")
        model = data.object("model")
        degraded = [
            Fault(fault.integer("barometer", 0, CELL_LIMIT - 1), fault.text("kind"))
            for fault in data.objects("degraded")
        ]
        epoch, seq, state = data.text("epoch"), data.integer("seq"), data.text("state")
        if state not in ("onset", "end"):
            data.fail("state", "'onset' or 'end'")
        site, rig, finger = _source(event)
        data.expect("finger", finger)
        event.expect("specversion", "1.0")
        event.expect("type", f"slip.{state}.v1")
        event.expect("id", f"{epoch}-{seq}")
        return cls(
            site,
            rig,
            finger,
            epoch,
            seq,
            onset=state == "onset",
            time=data.integer("sample_time_ns", -INT64),
            probability=data.nullable(data.fraction, "p"),
            latency=data.nullable(data.number, "latency_ms"),
            threshold=data.nullable(data.fraction, "threshold"),
            consecutive=data.nullable(data.integer, "consecutive"),
            model=model.text("id"),
            sha256=model.nullable(model.text, "sha256"),
            degraded=tuple(degraded),
            session=data.nullable(data.text, "session"),
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


def _source(event: Fields) -> tuple[str, str, str]:
    parts = [unquote(part) for part in event.text("source").split("/")]
    if parts[0] or not all(parts[1:]) or len(parts) != len(("", "site", "rig", "finger")):
        event.fail("source", "'/<site>/<rig>/<finger>'")
    if not "".join(parts).isprintable():
        event.fail("source", "printable text")
    return parts[1], parts[2], parts[3]


def _finite(value: Json) -> Json:
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(each) for each in value]
    return value
