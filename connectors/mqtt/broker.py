"""Address, credentials and messages of an MQTT broker, and the pauses between connections."""

import asyncio
import os
import re
import ssl
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from random import uniform

from operators.errors import InputError, ParameterError, os_error_reason
from operators.ports import BackOff

USER = "SLIPFLOW_MQTT_USER"
PASSWORD = "SLIPFLOW_MQTT_PASSWORD"  # noqa: S105 - the variable's name
PASSWORD_FILE = "SLIPFLOW_MQTT_PASSWORD_FILE"  # noqa: S105 - the variable's name
CA = "SLIPFLOW_MQTT_CA"
CERTIFICATE = "SLIPFLOW_MQTT_CERTIFICATE"
TEXT_MAX = 2**16 - 1  # bytes of a user or password in MQTT
LASTING = 10.0  # s; a connection that ends sooner is brief
BRIEF_PAUSE = 1.0  # s, at least, after a brief connection
_PORTS = {"mqtt": 1883, "mqtts": 8883}
_URL = re.compile(r"(mqtts?)://(?:\[([0-9A-Fa-f:.]+)\]|([\w.-]+))(?::([0-9]{1,5}))?")


@dataclass(frozen=True, slots=True)
class Message:
    """A message to publish."""

    topic: str
    payload: bytes
    retain: bool = True
    content_type: str = ""


@dataclass(frozen=True)
class Broker:
    """Address of an MQTT broker.

    User and password come from the environment variables SLIPFLOW_MQTT_USER and SLIPFLOW_MQTT_PASSWORD, or
    from the file named by SLIPFLOW_MQTT_PASSWORD_FILE. ``mqtts`` trusts the certificate authorities of the
    system (or of the file named by SSL_CERT_FILE), or only those in the file named by SLIPFLOW_MQTT_CA. It
    presents the client certificate of the file named by SLIPFLOW_MQTT_CERTIFICATE, which also has its key.
    """

    scheme: str  # mqtt or mqtts (TLS)
    host: str
    port: int

    @classmethod
    def parse(cls, url: str, owner: str = "Mqtt") -> "Broker":
        """Parse ``mqtt://host[:port]`` or ``mqtts://host[:port]``.

        >>> print(Broker.parse("mqtts://broker.example"))
        mqtts://broker.example:8883

        Raises:
            ParameterError: naming `owner`, if `url` has another form or contains credentials.
        """
        _, credentials, rest = url.rpartition("@")
        if credentials:
            must_be = f"without credentials: set {USER} and {PASSWORD}"
            raise ParameterError(owner, "url", f"...@{rest}", must_be)
        match = _URL.fullmatch(url)
        port = int(match[4] or _PORTS[match[1]]) if match else 0
        if not (match and 0 < port < 2**16):
            must_be = "like mqtt://host, mqtt://host:1883 or mqtts://host, with a port from 1 to 65535"
            raise ParameterError(owner, "url", url, must_be)
        return cls(match[1], match[2] or match[3], port)

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"

    def login(self) -> tuple[str | None, str | None]:
        """Return user and password, each None if not set.

        Raises:
            InputError: if the password file cannot be read, or MQTT cannot send one of them.
        """
        user, password = os.environ.get(USER), os.environ.get(PASSWORD)
        if path := os.environ.get(PASSWORD_FILE):
            try:
                password = Path(path).read_text(encoding="utf-8").rstrip("\r\n")
            except (OSError, UnicodeError) as error:
                why = os_error_reason(error) if isinstance(error, OSError) else "is not UTF-8 text"
                raise InputError(path, f"cannot read the password ({PASSWORD_FILE}): {why}") from None
        for name, text in (USER, user or ""), (path or PASSWORD, password or ""):
            sent = text.encode(errors="ignore")
            if sent.decode() != text or len(sent) > TEXT_MAX:
                raise InputError(name, f"must be a user or password of at most {TEXT_MAX} bytes in UTF-8")
        return user, password

    def tls(self) -> ssl.SSLContext:
        """Return the TLS context with the trusted certificate authorities and the client certificate.

        Raises:
            InputError: if a file of certificates cannot be read.
        """
        path = os.environ.get(CA) or None
        try:
            context = ssl.create_default_context(cafile=path)
        except ssl.SSLError:
            raise InputError(str(path), f"contains no CA certificate in PEM format ({CA})") from None
        except OSError as error:
            reason = f"cannot read the CA certificates ({CA}): {os_error_reason(error)}"
            raise InputError(str(path), reason) from None
        try:
            if own := os.environ.get(CERTIFICATE):
                context.load_cert_chain(own, password="")  # never asks for a passphrase
        except ssl.SSLError:
            reason = f"contains no private key of its certificate, without a passphrase ({CERTIFICATE})"
            raise InputError(str(own), f"{reason}: cat client.crt client.key > client.pem") from None
        except OSError as error:
            reason = f"cannot read the client certificate ({CERTIFICATE}): {os_error_reason(error)}"
            raise InputError(str(own), reason) from None
        return context


@dataclass
class Pauses:
    """Pauses before connecting again: short after a connection that lasted, else twice the last, up to 5 s.

    So clients that take over each other's connection do so at most once a second.
    """

    retry: BackOff = field(default_factory=BackOff)
    brief: int = field(default=0, init=False)  # brief connections in a row, without a failed attempt
    _connected: float = field(default=inf, init=False)  # loop time, s; inf: not since the last pause

    def connected(self) -> None:
        """Note that a connection begins."""
        self._connected = asyncio.get_running_loop().time()

    async def wait(self) -> None:
        """Wait until the next attempt."""
        lasted = asyncio.get_running_loop().time() - self._connected
        if lasted > LASTING:
            self.retry.reset()
        self.brief = self.brief + 1 if 0 <= lasted <= LASTING else 0
        least = BRIEF_PAUSE if self.brief else 0.0
        self._connected = inf
        spread = uniform(0.5, 1)  # noqa: S311 - clients that lost their broker do not return all at once
        await asyncio.sleep(max(least, self.retry.delay() * spread))
