"""Slip events on the wire: CloudEvents 1.0 in structured JSON, as ``slip-event.schema.json`` describes them.

Pure: nothing here reads a clock or talks to anybody. Source: https://github.com/cloudevents/spec, v1.0.2.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from math import isfinite
from typing import NoReturn, TypeVar
from urllib.parse import quote, unquote

import numpy as np

from operators.batch import BAROMETERS, EVERY, Faults
from operators.errors import InputError, ParameterError
from operators.health import FaultKind
from operators.ports import Json

T = TypeVar("T")

_INT64 = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Fault:
    """A barometer that could not be trusted at the time of an event."""

    barometer: int  # 0..5
    kind: str  # what is wrong with it, such as stuck


@dataclass(frozen=True, slots=True)
class Event:
    """One onset or end of slip, as it is published.

    >>> event = Event("lab", "ur10", "0", "s1", 7, onset=True, time=1_500_000_000, probability=0.9, latency=8)
    >>> Event.decode(event.encode()) == event
    True
    >>> import json
    >>> document = json.loads(event.encode())
    >>> document["type"], document["source"], document["id"], document["time"]
    ('slip.onset.v1', '/lab/ur10/0', 's1-7', '1970-01-01T00:00:01.500000000Z')
    >>> document["data"]["p"], document["data"]["quality"]
    (0.9, 'good')
    """

    site: str
    rig: str
    finger: str
    epoch: str  # the run that raised it
    seq: int  # counts from 1 in each epoch; a gap is an event that was lost
    onset: bool = field(kw_only=True)  # False: the end of a slip
    time: int = field(kw_only=True)  # ns since 1970-01-01 UTC, the sample that decided
    probability: float | None = field(kw_only=True)  # of slip, 0..1; None: not known
    latency: float = field(kw_only=True)  # ms, from the sample to when the event was made
    threshold: float | None = field(default=None, kw_only=True)  # of the probability; None: not known
    consecutive: int | None = field(default=None, kw_only=True)  # samples that decide; None: not known
    model: str = field(default="unknown", kw_only=True)  # identifier of the detector
    sha256: str | None = field(default=None, kw_only=True)  # of the detector's weights; None: not known
    degraded: tuple[Fault, ...] = field(default=(), kw_only=True)

    @property
    def state(self) -> str:
        """Onset or end."""
        return "onset" if self.onset else "end"

    @property
    def identifier(self) -> str:
        """The same for every copy of an event, different between events."""
        return f"{self.epoch}-{self.seq}"

    def encode(self) -> bytes:
        """The event as a CloudEvent in JSON."""
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
                    "quality": "degraded" if self.degraded else "good",
                    "degraded": [asdict(fault) for fault in self.degraded],
                },
            }
        )

    @classmethod
    def decode(cls, payload: bytes, where: str = "event") -> "Event":
        """Read what `encode` writes; fields that it does not know are ignored.

        Raises:
            InputError: naming `where`, and the field that is missing or wrong.
        """
        try:
            document: Json = json.loads(payload, parse_constant=_refuse)
        except (ValueError, RecursionError) as error:
            raise InputError(where, f"is not JSON: {error}") from None
        event = _Fields({"": document}, where).object("")
        data = event.object("data")
        model = data.object("model")
        degraded = [
            Fault(fault.whole("barometer", 0, BAROMETERS - 1), fault.text("kind"))
            for fault in data.objects("degraded")
        ]
        epoch, seq, state = data.text("epoch"), data.whole("seq"), data.text("state")
        if state not in ("onset", "end"):
            data.fail("state", "'onset' or 'end'")
        site, rig, finger = event.source()
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
            time=data.whole("sample_time_ns", -_INT64),
            probability=data.maybe(data.share, "p"),
            latency=data.number("latency_ms"),
            threshold=data.maybe(data.share, "threshold"),
            consecutive=data.maybe(data.whole, "consecutive"),
            model=model.text("id"),
            sha256=model.maybe(model.text, "sha256"),
            degraded=tuple(degraded),
        )


@dataclass(frozen=True, slots=True)
class _Fields:
    """A JSON object whose fields are read by name and type."""

    values: Mapping[str, Json]
    where: str  # the message that it belongs to
    path: str = ""  # to it, in that message

    def fail(self, name: str, must_be: str) -> NoReturn:
        found = f"is {self.values[name]!r:.60}" if name in self.values else "is missing"
        raise InputError(self.where, f"{self.path}{name} {found}, must be {must_be}".lstrip())

    def expect(self, name: str, value: str) -> None:
        if self.values.get(name) != value:
            self.fail(name, repr(value))

    def text(self, name: str) -> str:
        value = self.values.get(name)
        if not isinstance(value, str) or not value.isprintable():
            self.fail(name, "printable text")
        return value

    def number(self, name: str) -> float:
        value = self.values.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _INT64:
            self.fail(name, "a number")
        return float(value)

    def share(self, name: str) -> float:
        value = self.number(name)
        if not 0 <= value <= 1:
            self.fail(name, "from 0 to 1")
        return value

    def whole(self, name: str, least: int = 1, greatest: int = _INT64) -> int:
        value = self.values.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= greatest:
            self.fail(name, f"a whole number from {least} to {greatest}")
        return value

    def source(self) -> tuple[str, str, str]:
        parts = [unquote(part) for part in self.text("source").split("/")]
        if parts[0] or not all(parts[1:]) or len(parts) != len(("", "site", "rig", "finger")):
            self.fail("source", "'/<site>/<rig>/<finger>'")
        if not "".join(parts).isprintable():
            self.fail("source", "printable text")
        return parts[1], parts[2], parts[3]

    def maybe(self, read: Callable[[str], T], name: str) -> T | None:
        return None if self.values.get(name, 0) is None else read(name)

    def object(self, name: str) -> "_Fields":
        value = self.values.get(name)
        if not isinstance(value, dict):
            self.fail(name, "an object")
        return _Fields(value, self.where, f"{self.path}{name}.".lstrip("."))

    def objects(self, name: str) -> list["_Fields"]:
        value = self.values.get(name)
        if not isinstance(value, list):
            self.fail(name, "a list")
        items = {f"{name}[{i}]": each for i, each in enumerate(value)}
        return [_Fields(items, self.where, self.path).object(item) for item in items]


def encode(document: Json) -> bytes:
    """Compact JSON; numbers that JSON does not have become null.

    >>> encode({"p": float("nan"), "rates": [100.0, float("inf")]})
    b'{"p":null,"rates":[100.0,null]}'
    """
    return json.dumps(_finite(document), separators=(",", ":"), allow_nan=False).encode()


def timestamp(time: int) -> str:
    """RFC 3339, UTC, of ns since 1970.

    >>> timestamp(1_600_000_000_123_456_789)
    '2020-09-13T12:26:40.123456789Z'
    """
    return f"{np.datetime64(time, 'ns')}Z"


def finger_name(finger: int) -> str:
    """What a fingertip is called in topics and events.

    >>> finger_name(2), finger_name(EVERY)
    ('2', 'every')
    """
    return "every" if finger == EVERY else str(finger)


def faults(batch: Faults) -> Iterator[tuple[int, Fault, bool]]:
    """The rows of a batch: when (ns), what, and whether it begins."""
    rows = (batch.time.tolist(), batch.barometer.tolist(), batch.kind.tolist(), batch.active.tolist())
    for time, barometer, kind, active in zip(*rows, strict=True):
        yield time, Fault(barometer, FaultKind(kind).name.lower()), active


def topic(owner: str, site: str, rig: str, *, wildcard: str | None = None) -> str:
    """The MQTT topic below which a rig publishes.

    >>> topic("Mqtt", "lab", "ur10")
    'slip/v1/lab/ur10'

    Raises:
        ParameterError: naming `owner`, if one of them is not a level of a topic, or `wildcard`.
    """
    for name, part in ("site", site), ("rig", rig):
        if part != wildcard and (not part or not part.isprintable() or set(part) & set("/+#")):
            raise ParameterError(owner, name, part, "printable text without '/', '+' and '#'")
    return f"slip/v1/{site}/{rig}"


def _finite(value: Json) -> Json:
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_finite(each) for each in value]
    return value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number of JSON")
