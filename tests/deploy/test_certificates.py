"""Client certificates from deploy/mosquitto/make_certificates, with a real mosquitto."""

import asyncio
import re
import ssl
import subprocess
from pathlib import Path

import pytest

from connectors import Mqtt
from connectors.mqtt.broker import CA, CERTIFICATE, Broker
from connectors.mqtt.broker_link import connect
from flows.run.clocks import LoopClock
from flows.run.diagnosis import diagnose
from operators.errors import EndpointError, InputError
from operators.ports import Finding
from tests.connectors.mqtt.broker_process import TestBroker, deliver
from tests.deploy.shipped import DEPLOY, settings

pytestmark = pytest.mark.broker
_context = ssl.create_default_context
TLS = (DEPLOY / "mosquitto" / "tls.conf").read_text()


def make(folder: Path, *users: str) -> None:
    script = DEPLOY / "mosquitto" / "make_certificates"
    subprocess.run([script, folder, "127.0.0.1", *users], check=True)


async def meet(url: str) -> None:
    link = await connect(Broker.parse(url), "test")
    try:
        await deliver(link, "slip/v1/lab/fingertip/status")
    finally:
        await link.disconnect()


async def findings(sink: Mqtt) -> list[Finding]:
    return (await diagnose({"mqtt": sink}, LoopClock()))["mqtt"]


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
    _, *tls = [line for line in TLS.splitlines() if not line.startswith("#")]
    tls = [line.replace("/mosquitto/config", str(tmp_path)) for line in tls]
    with TestBroker(tmp_path, *tls, *settings(tmp_path)) as broker:
        url = broker.url.replace("mqtt:", "mqtts:")
        with pytest.raises(EndpointError, match=rf"; if it asks for client certificates, set {CERTIFICATE}"):
            asyncio.run(meet(url))
        monkeypatch.setenv(CERTIFICATE, str(tmp_path / "other" / "fingertip.pem"))
        with pytest.raises(EndpointError, match="cannot connect"):
            asyncio.run(meet(url))
        monkeypatch.setenv(CERTIFICATE, str(tmp_path / "fingertip.pem"))
        asyncio.run(meet(url))
        sink = Mqtt(url, "lab", "fingertip", outbox=tmp_path / "outbox")
        found = asyncio.run(findings(sink))
        assert [each.text for each in found if "admits" in each.text] == [
            f"admits this client with the certificate {tmp_path / 'fingertip.pem'}"
        ]
        assert found[-1].text.startswith("accepts slip/v1/lab/fingertip/doctor")


def test_the_page_installs_the_files_that_the_broker_reads_for_its_user(tmp_path: Path) -> None:
    page = (DEPLOY.parent / "docs" / "how-to" / "deploy.md").read_text()
    flags = re.MULTILINE
    [install] = re.findall(r"^    sudo install -m 600 -o mosquitto -t (/\S+) (certificates/.*)$", page, flags)
    make(tmp_path, "fingertip")
    read = re.findall(r"^\w+file /mosquitto/config/(\S+)$", TLS, flags)
    assert [f"certificates/{name}" for name in read] == install[1].split()
    assert all((tmp_path / name).is_file() for name in read)


def test_a_missing_client_certificate_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CERTIFICATE, "/missing.pem")
    with pytest.raises(InputError, match=rf"cannot use the client certificate and its key \({CERTIFICATE}\)"):
        Broker.parse("mqtts://localhost").tls()
