import json
from collections.abc import Mapping

import pytest

from connectors.documents import MESSAGE_MAX, Document, Number, decode
from operators.errors import InputError


class Seen(Document, frozen=True):
    seq: Number
    text: str = ""


def test_a_too_large_document_is_rejected_unparsed() -> None:
    payload = b'{"seq": 1, "more": "' + b"x" * MESSAGE_MAX + b'"}'
    reason = rf"^here: is {len(payload)} bytes long; the limit is {MESSAGE_MAX}$"
    with pytest.raises(InputError, match=reason):
        decode(payload, Seen, "here")
    assert decode(payload, Seen, "here", largest=len(payload)) == Seen(1)


@pytest.mark.parametrize(
    "payload", [b"", b"\xff", b"[1]", b"NaN", b"[" * 60_000, b'{"more": ' + b"[" * 60_000, b'{"seq": 1e999}']
)
def test_other_texts_are_rejected(payload: bytes) -> None:
    with pytest.raises(InputError, match=r"^here: "):
        decode(payload, Seen, "here")


@pytest.mark.parametrize(
    "fields", [{}, {"seq": 0}, {"seq": True}, {"seq": 1.5}, {"seq": 2**63}, {"seq": 10**999}, {"seq": "1"}]
)
def test_a_wrong_field_is_named(fields: Mapping[str, object]) -> None:
    with pytest.raises(InputError, match=r"^here: .*seq`"):
        decode(json.dumps(fields).encode(), Seen, "here")


def test_control_characters_are_rejected() -> None:
    with pytest.raises(InputError, match=r"^here: `text` must be printable text"):
        decode(b'{"seq": 1, "text": "a\\u001bb"}', Seen, "here")
