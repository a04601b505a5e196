import pytest

from connectors.fields import MESSAGE_MAX, Fields
from operators.errors import InputError


def test_a_too_large_message_is_rejected_unparsed() -> None:
    payload = b'{"a": "' + b"x" * MESSAGE_MAX + b'"}'
    with pytest.raises(
        InputError, match=rf"^here: is {len(payload)} bytes long; the limit is {MESSAGE_MAX}$"
    ):
        Fields.parse(payload, "here")
    assert Fields.parse(payload, "here", largest=len(payload)).text("a")


@pytest.mark.parametrize("payload", [b"", b"\xff", b"[1]", b"NaN", b"[" * 60_000])
def test_non_objects_are_rejected(payload: bytes) -> None:
    with pytest.raises(InputError, match=r"^here: "):
        Fields.parse(payload, "here")


def test_ranges_are_pairs_in_order() -> None:
    assert Fields({"missing": [[1, 2], [4, 4]]}, "here").ranges("missing") == [(1, 2), (4, 4)]


@pytest.mark.parametrize("ranges", [1, [1], [[1]], [[2, 1]], [[0, 1]], [[1, 2.5]], [[1, True]], [[1, 2, 3]]])
def test_malformed_ranges_are_rejected_by_name(ranges: list[object]) -> None:
    with pytest.raises(InputError, match=r"^here: missing.* must be"):
        Fields({"missing": ranges}, "here").ranges("missing")  # type: ignore[dict-item]


def test_a_nullable_field_may_not_be_missing() -> None:
    fields = Fields({"a": None, "b": "x"}, "here")
    assert [fields.nullable(fields.text, name) for name in "ab"] == [None, "x"]
    with pytest.raises(InputError, match="c is missing"):
        fields.nullable(fields.text, "c")
