"""Typed reading of JSON documents, whose errors name the field; `connectors.events.encode` writes them."""

from typing import Annotated, Final, TypeVar

import msgspec
from msgspec import Meta

from operators.errors import InputError

INT64: Final = 2**63 - 1
MESSAGE_MAX: Final = 64 * 1024  # bytes

Number = Annotated[int, Meta(ge=1, le=INT64)]
Count = Annotated[int, Meta(ge=0, le=INT64)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
T = TypeVar("T", bound=msgspec.Struct)


class Document(msgspec.Struct, frozen=True):
    """JSON object whose texts are printable. Subclasses declare its fields; others are ignored.

    >>> class Head(Document, frozen=True):
    ...     epoch: str
    ...     last_seq: Count
    >>> decode(b'{"epoch": "ab", "last_seq": 7, "more": null}', Head, "message")
    Head(epoch='ab', last_seq=7)
    >>> decode(b'{"epoch": "ab", "last_seq": -1}', Head, "message")
    Traceback (most recent call last):
    operators.errors.InputError: message: Expected `int` >= 0 - at `$.last_seq`
    """

    def __post_init__(self) -> None:
        """Reject other characters; `decode` adds the path."""
        for name, value in msgspec.structs.asdict(self).items():
            if isinstance(value, str) and not value.isprintable():
                raise ValueError(f"`{name}` must be printable text")


def decode(payload: bytes, kind: type[T], where: str, *, largest: int = MESSAGE_MAX) -> T:
    """Decode a JSON document.

    Raises:
        InputError: naming `where` and the field that is missing or wrong, or if it is larger than `largest`
            bytes.
    """
    if len(payload) > largest:
        raise InputError(where, f"is {len(payload)} bytes long; the limit is {largest}")
    try:
        return msgspec.json.decode(payload, type=kind)
    except (ValueError, RecursionError) as error:
        reason = str(error)[:200]
        raise InputError(where, reason if reason.isprintable() else "is not JSON") from None
