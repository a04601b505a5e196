"""Findings about an MQTT broker before a run: login, encryption, access rights and response time."""

import os
import ssl
import time
from collections.abc import AsyncGenerator
from contextlib import suppress
from secrets import token_hex
from typing import Final

from connectors.mqtt.broker import CA, CERTIFICATE, USER, Broker, Message
from connectors.web.access import is_loopback
from operators.batch import ms
from operators.errors import EndpointError
from operators.ports import Clock, Finding

EXPIRES_SOON: Final = 14.0  # days
DAY: Final = 86400.0  # s


async def diagnose_broker(broker: Broker, topic: str, clock: Clock) -> AsyncGenerator[Finding]:
    """Yield findings about a broker, which gets one message on `topic`, not retained.

    Raises:
        EndpointError: if the broker is unreachable or refuses the client or the message.
        InputError: if a file with credentials cannot be read.
    """
    from connectors.mqtt.broker_link import connect  # noqa: PLC0415 - aiomqtt is slow to import

    user, password = broker.login()
    link = await connect(broker, f"slipflow-doctor-{token_hex(4)}")
    try:
        yield _login(broker, user, password)
        if broker.scheme == "mqtts":
            yield _certificate(broker, link.peer_certificate())
        start = clock.now()
        [refusal] = await link.send_all([Message(topic, b"{}", retain=False)])
        if refusal:
            raise EndpointError(str(broker), refusal)
        yield Finding(str(broker), f"accepts {topic} within {(clock.now() - start) / ms:.1f} ms")
    finally:
        await link.disconnect()


def _login(broker: Broker, user: str | None, password: str | None) -> Finding:
    """Return how the client logs in, with a note if its password can be read on the network."""
    who = f"user {user}{' with a password' if password else ''}" if user else "any client"
    if broker.scheme == "mqtts" and (own := os.environ.get(CERTIFICATE)):
        return Finding(str(broker), f"admits {who if user else 'this client'} with the certificate {own}")
    if password and broker.scheme == "mqtt" and not is_loopback(broker.host):
        text = f"admits {who}, sent without encryption: set up TLS and write mqtts://"
        return Finding(str(broker), text, "note")
    remedy = f"; set {USER} if it should not" if not user and not is_loopback(broker.host) else ""
    return Finding(str(broker), f"admits {who}{remedy}", "note" if remedy else "good")


def _certificate(broker: Broker, certificate: dict[str, object]) -> Finding:
    """Return for how long the broker's certificate is valid."""
    end = str(certificate.get("notAfter", ""))
    left = 0.0
    with suppress(ValueError):
        left = (ssl.cert_time_to_seconds(end) - time.time()) / DAY
    text = f"TLS with a trusted certificate, valid for {left:.0f} days"
    if left > EXPIRES_SOON:
        return Finding(str(broker), text)
    return Finding(str(broker), f"{text}: renew it, and set {CA} if another authority signs it", "note")
