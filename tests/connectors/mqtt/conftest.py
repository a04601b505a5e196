"""Brokers with access control and with TLS."""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from connectors.mqtt.broker import PASSWORD, USER
from tests.connectors.mqtt.broker_process import TestBroker
from tests.inside import inside


@pytest.fixture
def guarded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[TestBroker]:
    """A broker that lets in only the user rig, who may only use topics below mine; we are that user."""
    passwords, rights = tmp_path / "passwords", tmp_path / "rights"
    subprocess.run(["mosquitto_passwd", "-c", "-b", passwords, "rig", "right"], check=True)
    rights.write_text("user rig\ntopic readwrite mine/#\n")
    monkeypatch.setenv(USER, "rig")
    monkeypatch.setenv(PASSWORD, "right")
    broker = TestBroker(tmp_path, f"password_file {passwords}", f"acl_file {rights}", "allow_anonymous false")
    yield broker
    broker.close()


@pytest.fixture(scope="session")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestBroker]:
    """A broker that speaks TLS, with a certificate that it signed itself."""
    folder = tmp_path_factory.mktemp("secure")
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"]
    kind = ["-x509", *curve, "-nodes", "-days", "2", "-subj", "/CN=test"]
    files = ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(certificate)]
    subprocess.run(["openssl", "req", *kind, *files], check=True, capture_output=True)
    with TestBroker(folder, "allow_anonymous true", f"certfile {certificate}", f"keyfile {key}") as broker:
        yield broker


@pytest.fixture
def secure(secured: TestBroker, tmp_path: Path) -> TestBroker:
    shutil.copy(inside(secured, "_log").with_name("certificate.pem"), tmp_path)
    return secured
