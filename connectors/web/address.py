"""Addresses of what is served over HTTP."""

from contextlib import suppress
from ipaddress import ip_address
from typing import Final

PAGE_PORT: Final = 8765  # unless another is asked for, as is the next
METRICS_PORT: Final = 9464  # usual for an application that exports its own metrics


def address(host: str, port: int) -> str:
    """An address as it is written.

    >>> address("::1", 8765)
    'http://[::1]:8765'
    """
    return f"http://{f'[{host}]' if ':' in host else host}:{port}"


def is_loopback(host: str) -> bool:
    """Whether only this machine gets to what listens there.

    >>> is_loopback("127.0.0.1"), is_loopback("::1"), is_loopback("localhost"), is_loopback("0.0.0.0")
    (True, True, True, False)
    """
    with suppress(ValueError):
        return ip_address(host).is_loopback
    return host == "localhost"


def reachable(host: str) -> str:
    """Where a browser on the same machine finds what listens on `host`.

    >>> reachable("0.0.0.0"), reachable("::"), reachable("10.0.0.2")
    ('127.0.0.1', '::1', '10.0.0.2')
    """
    return {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104 - nothing listens here
