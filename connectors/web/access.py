"""Addresses of the web server, and access control: token, cookie and Host header."""

import hmac
import os
import re
from contextlib import suppress
from ipaddress import ip_address
from socket import gethostname
from typing import Final
from urllib.parse import urlsplit

from operators.errors import ParameterError

PAGE_PORT: Final = 8765
METRICS_PORT: Final = 9464  # the default of OpenTelemetry's Prometheus exporter
TOKEN: Final = "SLIPFLOW_PAGE_TOKEN"  # noqa: S105 - the variable's name
COOKIE: Final = "slipflow_page"
_TOKEN: Final = re.compile(r"[A-Za-z0-9._~-]{16,256}")


def http_url(host: str, port: int) -> str:
    """Return the URL of a host and port.

    >>> http_url("::1", 8765)
    'http://[::1]:8765'
    """
    return f"http://{f'[{host}]' if ':' in host else host}:{port}"


def is_loopback(host: str) -> bool:
    """Return True if a server that listens on `host` is reachable from this machine only.

    >>> is_loopback("127.0.0.1"), is_loopback("::1"), is_loopback("localhost"), is_loopback("0.0.0.0")
    (True, True, True, False)
    """
    with suppress(ValueError):
        return ip_address(host).is_loopback
    return host == "localhost"


def required_token(what: str, host: str) -> str | None:
    """Return the token in SLIPFLOW_PAGE_TOKEN that a server on `host` requires; None: it requires none.

    Raises:
        ParameterError: if the token is malformed, or missing although other machines can reach `host`; it
            names the sink `what`.
    """
    token = os.environ.get(TOKEN) or None
    if token is None and not is_loopback(host):
        raise ParameterError(what, "host", host, f"127.0.0.1, or set {TOKEN} for other machines")
    if token is not None and not _TOKEN.fullmatch(token):
        must_be = "16 to 256 letters, digits, '.', '_', '~' or '-', for example from: openssl rand -hex 16"
        raise ParameterError(what, "token", "...", must_be)
    return token


def is_own_host(host: str) -> bool:
    """Return True if a Host header names this machine, by its address or name.

    >>> [is_own_host(host) for host in ("127.0.0.1:8765", "[::1]", "localhost:80", "evil.example")]
    [True, True, True, False]
    """
    own = gethostname().lower()
    short = own.partition(".")[0]
    with suppress(ValueError):  # neither a name nor an address
        name = (urlsplit(f"//{host}").hostname or "").removesuffix(".")
        return name in {"localhost", own, short, f"{short}.local"} or bool(ip_address(name))
    return False


def is_secret(sent: str | None, secret: str) -> bool:
    """Return True if the part of a request that was sent, if any, is a secret; takes constant time."""
    # a header that is not UTF-8 contains surrogates
    return sent is not None and hmac.compare_digest(sent.encode(errors="surrogateescape"), secret.encode())
