import json
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from msgspec.structs import replace

from connectors.documents import MESSAGE_MAX, Document, Number, decode
from connectors.events import Event, Fault, Model, encode
from operators.errors import InputError
from operators.fingertip import CELL_LIMIT
from operators.ports import Json
from tests.asyncapi import EVENT_SCHEMA
from tests.connectors.mqtt import made

VALIDATOR: Any = Draft202012Validator(EVENT_SCHEMA)
letters = st.characters(exclude_categories=["C", "Z"]) | st.just(" ")  # what `str.isprintable` lets pass
names = st.text(letters, min_size=1, max_size=8)
parts = st.text(letters.filter(lambda letter: letter not in "/+#"), min_size=1, max_size=8)
shares = st.none() | st.floats(0, 1)
events = st.builds(
    Event,
    site=parts,
    rig=parts,
    finger=parts,
    epoch=names,
    seq=st.integers(1, 2**63 - 1),
    state=st.sampled_from(["onset", "end"]),
    time=st.integers(1 - 2**63, 2**63 - 1),
    probability=shares,
    latency=st.none() | st.floats(-1e12, 1e12),
    threshold=shares,
    consecutive=st.none() | st.integers(1, 1000),
    model=st.builds(Model, names, st.none() | st.text("0123456789abcdef", min_size=64, max_size=64)),
    degraded=st.lists(
        st.builds(Fault, st.integers(0, CELL_LIMIT - 1), names | st.just("saturated")), max_size=3
    ).map(tuple),
    session=st.none() | names,
)

EVENT = replace(made.EVENT, degraded=(Fault(2, "stuck"),))
READ: list[tuple[str | int, ...]] = [
    *[(name,) for name in EVENT_SCHEMA["required"] if name not in ("time", "datacontenttype")],
    *[("data", name) for name in EVENT_SCHEMA["properties"]["data"]["required"] if name != "quality"],
    ("data", "model", "id"),
    ("data", "model", "sha256"),
    ("data", "degraded", 0),
    ("data", "degraded", 0, "barometer"),
    ("data", "degraded", 0, "kind"),
]


KNOWN_DEFAULTS = ("threshold", "consecutive", "model", "degraded", "session")
OPTIONAL = {*((name,) for name in KNOWN_DEFAULTS), ("degraded", 0), ("model", "sha256")}


def altered(path: tuple[str | int, ...], *value: Json) -> bytes:
    """The event with one field removed, or set to `value`."""
    document: Any = json.loads(EVENT.encode())
    place = document
    for step in path[:-1]:
        place = place[step]
    if value:
        place[path[-1]] = value[0]
    else:
        del place[path[-1]]
    return json.dumps(document).encode()


def is_valid(payload: bytes) -> bool:
    return not list(VALIDATOR.iter_errors(json.loads(payload)))


@given(events)
def test_every_event_satisfies_the_schema_and_is_read_back_the_same(event: Event) -> None:
    payload = event.encode()
    assert is_valid(payload)
    assert Event.decode(payload) == event


@pytest.mark.parametrize(
    ("kinds", "probability", "quality", "reason"),
    [
        ((), 0.9, "good", None),
        (("saturated",), 0.9, "good", None),
        (("saturated", "stuck", "dead"), 0.9, "doubtful", "barometer 1 stuck, barometer 2 dead"),
        (("stuck",), None, "blind", "no probability"),
    ],
)
def test_broken_cells_make_an_event_doubtful_and_a_missing_probability_makes_it_blind(
    kinds: tuple[str, ...], probability: float | None, quality: str, reason: str | None
) -> None:
    faults = tuple(Fault(cell, kind) for cell, kind in enumerate(kinds))
    event = replace(EVENT, probability=probability, degraded=faults)
    assert (event.quality, event.reason) == (quality, reason)
    assert is_valid(event.encode())
    document = json.loads(event.encode())
    document["data"]["quality"] = "doubtful" if quality == "good" else "good"
    assert not is_valid(json.dumps(document).encode())


@pytest.mark.parametrize("path", READ, ids=str)
@pytest.mark.parametrize("value", [True, ["x"], {"x": "y"}, -1.5, "\n"], ids=repr)
def test_a_value_that_violates_the_schema_is_rejected_by_name(
    path: tuple[str | int, ...], value: Json
) -> None:
    payload = altered(path, value)
    if is_valid(payload):
        Event.decode(payload)
    else:
        with pytest.raises(InputError, match=r"^here: ") as caught:
            Event.decode(payload, "here")
        assert str(path[-1] if isinstance(path[-1], str) else "degraded") in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", [path for path in READ if path[1:] not in OPTIONAL], ids=str)
def test_a_missing_field_is_named(path: tuple[str | int, ...]) -> None:
    assert not is_valid(altered(path))
    with pytest.raises(InputError, match=f"missing required field `{path[-1]}`"):
        Event.decode(altered(path))


@given(st.dictionaries(names.filter(lambda name: name not in {"site", "rig"}), st.text()))  # of the source
def test_unknown_fields_are_ignored(unknown: dict[str, str]) -> None:
    document = json.loads(EVENT.encode())
    for place in (document, document["data"], document["data"]["model"], document["data"]["degraded"][0]):
        place.update({key: value for key, value in unknown.items() if key not in place})
    payload = json.dumps(document).encode()
    assert is_valid(payload)
    assert Event.decode(payload) == EVENT


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


@given(st.binary() | json_values.map(json.dumps).map(str.encode))
@example(b"[" * 100_000)
@example(b'{"data": NaN}')
def test_any_malformed_payload_raises_an_input_error(payload: bytes) -> None:
    with pytest.raises(InputError, match=r"^here: ") as caught:
        Event.decode(payload, "here")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("type", "slip.end.v1"),
        ("id", "ab-2"),
        ("specversion", "2.0"),
        ("source", "/lab/ur10/1"),
        ("source", "/lab/0"),
        ("source", "lab/ur10/0"),
        ("source", "/lab//0"),
        ("source", "/lab/a%0Ab/0"),
    ],
)
def test_contradictory_fields_are_rejected(name: str, value: str) -> None:
    with pytest.raises(InputError, match=name if name != "source" else "source|finger"):
        Event.decode(altered((name,), value))


def test_values_of_numpy_and_of_any_sequence_are_written_and_unknown_ones_as_null() -> None:
    document: Any = {
        "gain": np.float32(2.5),
        "on": np.bool_(True),
        "cells": np.arange(3, dtype=np.int16),
        "map": np.array([[1.5, np.nan]], np.float32),
        "rows": ("one", float("inf"), range(2)),
    }
    written = b'{"gain":2.5,"on":true,"cells":[0,1,2],"map":[[1.5,null]],"rows":["one",null,[0,1]]}'
    assert encode(document) == written
    assert encode({**document, "\udcff": 1}) == written[:-1] + b',"?":1}'  # which is not UTF-8


class Seen(Document, frozen=True):
    seq: Number
    text: str = ""


def test_a_too_large_document_is_rejected_unparsed() -> None:
    payload = b'{"seq": 1, "more": "' + b"x" * MESSAGE_MAX + b'"}'
    reason = rf"^here: is {len(payload)} bytes long; the limit is {MESSAGE_MAX}$"
    with pytest.raises(InputError, match=reason):
        decode(payload, Seen, "here")
    assert decode(payload, Seen, "here", largest=len(payload)) == Seen(1)
