"""Messages as server-sent events. Source: https://html.spec.whatwg.org/multipage/server-sent-events.html."""

from connectors.events import encode
from operators.ports import Json


def message(name: str, document: Json) -> bytes:
    r"""A message as it goes out.

    >>> message("lost", 3)
    b'event: lost\ndata: 3\n\n'
    """
    return b"event: %b\ndata: %b\n\n" % (name.encode(), encode(document))
