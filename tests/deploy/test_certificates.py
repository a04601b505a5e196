"""Client certificates from deploy/mosquitto/make_certificates, with a real mosquitto."""

import asyncio
import ssl
import subprocess
from pathlib import Path

import pytest

from connectors.mqtt.broker import CA, CERTIFICATE, Broker
from connectors.mqtt.broker_link import connect
from operators.errors import EndpointError, InputError
from tests.connectors.mqtt.broker_process import TestBroker
from tests.deploy.shipped import DEPLOY

pytestmark = pytest.mark.broker
_context = ssl.create_default_context
SETTINGS = ("cafile", "certfile", "keyfile")


def make(folder: Path, *users: str) -> None:
    script = DEPLOY / "mosquitto" / "make_certificates"
    subprocess.run([script, folder, "127.0.0.1", *users], check=True)


async def meet(url: str) -> None:
    link = await connect(Broker.parse(url), "test")
    await link.disconnect()


def strict(cafile: str | None) -> ssl.SSLContext:
    """Return the context that Python 3.13 creates: it checks certificates as RFC 5280 demands."""
    context = _context(cafile=cafile)
    context.verify_flags |= ssl.VERIFY_X509_STRICT | ssl.VERIFY_X509_PARTIAL_CHAIN
    return context


def test_the_broker_admits_only_clients_with_a_certificate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ssl, "create_default_context", strict)
    make(tmp_path, "fingertip")
    make(tmp_path / "other", "fingertip")
    monkeypatch.setenv(CA, str(tmp_path / "ca.crt"))
    files = [
        f"{each} {tmp_path / name}"
        for each, name in zip(SETTINGS, ("ca.crt", "broker.crt", "broker.key"), strict=True)
    ]
    required = ("require_certificate true", "use_identity_as_username true", "allow_anonymous false")
    with TestBroker(tmp_path, *files, *required) as broker:
        url = broker.url.replace("mqtt:", "mqtts:")
        with pytest.raises(EndpointError, match="cannot connect"):
            asyncio.run(meet(url))
        monkeypatch.setenv(CERTIFICATE, str(tmp_path / "other" / "fingertip.pem"))
        with pytest.raises(EndpointError, match="cannot connect"):
            asyncio.run(meet(url))
        monkeypatch.setenv(CERTIFICATE, str(tmp_path / "fingertip.pem"))
        asyncio.run(meet(url))


def test_a_missing_client_certificate_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CERTIFICATE, "/missing.pem")
    with pytest.raises(InputError, match=rf"cannot use the client certificate and its key \({CERTIFICATE}\)"):
        Broker.parse("mqtts://localhost").tls()
