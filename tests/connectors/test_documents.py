"""What events, tested in test_events.py, do not have: a limit of size and texts to print."""

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


@pytest.mark.parametrize("number", ["0", "true", "1.5", "9223372036854775808", "1e999", '"1"'])
def test_a_wrong_number_is_named(number: str) -> None:
    with pytest.raises(InputError, match=r"^here: "):
        decode(f'{{"seq": {number}}}'.encode(), Seen, "here")


def test_control_characters_are_rejected() -> None:
    with pytest.raises(InputError, match=r"^here: `text` must be printable text"):
        decode(b'{"seq": 1, "text": "a\\u001bb"}', Seen, "here")
