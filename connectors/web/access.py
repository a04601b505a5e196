"""Who may see what is served over HTTP."""

import hmac
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from ipaddress import ip_address
from pathlib import Path
from socket import gethostname
from typing import Final, Self

from connectors.web.address import is_loopback
from operators.errors import InputError, ParameterError

TOKEN: Final = "SLIPFLOW_PAGE_TOKEN"  # noqa: S105 - the variable's name
TOKEN_FILE: Final = "SLIPFLOW_PAGE_TOKEN_FILE"  # noqa: S105 - the variable's name
COOKIE: Final = "slipflow_page"
_TOKEN: Final = re.compile(r"[A-Za-z0-9._~-]{16,256}")
_NAMED: Final = re.compile(r"(?:\[([0-9A-Fa-f:.]+)\]|([A-Za-z0-9._-]+))(?::[0-9]{1,5})?")


@dataclass(frozen=True)
class Access:
    """What a request must show.

    Its Host header must be an address, localhost or this machine's name. A page elsewhere whose own name was
    made to lead here (DNS rebinding) sends that name, and would else read what the browser's user may see.

    Where there is a token, a request must have the cookie that is set once the token was given, as in
    ``/?token=...``. It outlives the server, so that an open page comes back by itself.
    """

    token: str | None = None  # 16 to 256 letters, digits, '.', '_', '~' or '-'; None: everybody may
    any_name: bool = False  # whether the Host header may be anything: for what no browser is to read

    @classmethod
    def of(cls, host: str, token: str | None) -> Self:
        """Access to a page on `host`; without `token`, with that of the environment.

        That is SLIPFLOW_PAGE_TOKEN, or in the file that SLIPFLOW_PAGE_TOKEN_FILE names.

        Raises:
            ParameterError: if the token is none, or there is none and others than this machine may come.
            InputError: if the file cannot be read.
        """
        token = token or _token_of(os.environ)
        if token is None and not is_loopback(host):
            must_be = (
                f"set for a page that others can reach: in {TOKEN}, or in a file that {TOKEN_FILE} names"
            )
            raise ParameterError("Page", "token", None, must_be)
        if token is not None and not _TOKEN.fullmatch(token):
            must_be = "16 to 256 letters, digits, '.', '_', '~' or '-', as of: openssl rand -hex 16"
            raise ParameterError("Page", "token", "...", must_be)
        return cls(token)

    @property
    def cookie(self) -> str:
        """What the cookie must be."""
        return hmac.new((self.token or "").encode(), b"slipflow page", sha256).hexdigest()

    def is_named(self, host: str) -> bool:
        """Whether a Host header is one that this machine goes by.

        >>> [Access().is_named(host) for host in ("127.0.0.1:8765", "[::1]", "localhost:80", "evil.example")]
        [True, True, True, False]
        """
        if self.any_name:
            return True
        match = _NAMED.fullmatch(host)
        if match is None:
            return False
        name = (match[1] or match[2]).lower().removesuffix(".")
        own = gethostname().lower()
        if name in {"localhost", own, own.partition(".")[0], f"{own.partition('.')[0]}.local"}:
            return True
        try:
            ip_address(name)
        except ValueError:
            return False
        return True

    def knows(self, token: str) -> bool:
        """Whether that is the token."""
        return self.token is not None and hmac.compare_digest(token.encode(), self.token.encode())

    def lets_in(self, cookie: str | None) -> bool:
        """Whether a request with that cookie may see the page."""
        return self.token is None or (
            cookie is not None and hmac.compare_digest(cookie.encode(), self.cookie.encode())
        )


def _token_of(environment: Mapping[str, str]) -> str | None:
    path = environment.get(TOKEN_FILE)
    if not path:
        return environment.get(TOKEN) or None
    try:
        with Path(path).open(encoding="utf-8") as file:
            return file.read(1024).strip()
    except (OSError, UnicodeError) as error:
        raise InputError(path, f"cannot read the token ({TOKEN_FILE}): {error}") from None
