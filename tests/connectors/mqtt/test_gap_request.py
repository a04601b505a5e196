import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.fields import Fields
from connectors.mqtt.gap_request import GapAnswer, GapRequest
from operators.errors import InputError

RIG = "slip/v1/lab/ur10"
REQUEST = GapRequest("ab", 3, 9, f"{RIG}/replay/me")


def altered(request: GapRequest | GapAnswer, **values: Any) -> bytes:  # noqa: ANN401 - JSON
    document = {**json.loads(request.encode()), **values}
    return json.dumps({key: value for key, value in document.items() if value is not ...}).encode()


@pytest.mark.parametrize(
    "topic",
    [
        "",
        "elsewhere",
        f"{RIG}/0/event",
        f"{RIG}/replay",
        f"{RIG}/replay/",
        f"{RIG}/replay/request",
        f"{RIG}/replay/event",
        f"{RIG}/replay/a/b",
        f"{RIG}/replay/+",
        f"{RIG}/replay/#",
        f"{RIG}/replay/a\0b",
        f"{RIG}/replay/{'a' * 256}",
        "slip/v1/lab/other/replay/me",
        f"x{RIG}/replay/me",
        None,
        7,
    ],
)
def test_an_answer_goes_nowhere_but_below_the_rigs_own_replay(topic: object) -> None:
    with pytest.raises(InputError, match=rf"^{RIG}/replay/request: reply_to is .*must be"):
        GapRequest.decode(altered(REQUEST, reply_to=topic), RIG)


@pytest.mark.parametrize(
    ("name", "value"),
    [("epoch", 1), ("from", 0), ("to", 2), ("to", 2**63), ("from", True), ("epoch", ...), ("from", ...)],
)
def test_a_request_that_makes_no_sense_is_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(InputError, match=f"{name} is"):
        GapRequest.decode(altered(REQUEST, **{name: value}), RIG)


@given(st.binary())
def test_no_payload_does_worse_than_be_refused(payload: bytes) -> None:
    with pytest.raises(InputError):
        GapRequest.decode(payload, RIG)


@pytest.mark.parametrize("missing", [[[2, 4]], [[9, 10]], [[5, 4]], 7, ...])
def test_an_answer_that_tells_of_more_than_it_covers_is_refused(missing: object) -> None:
    payload = altered(GapAnswer("ab", 3, 9, ()), missing=missing)
    with pytest.raises(InputError, match="missing"):
        GapAnswer.read(Fields.parse(payload, "here"))
