"""The broker configuration in deploy/, for tests and a benchmark."""

import os
import shutil
import subprocess
from pathlib import Path
from typing import Final

from tests.connectors.mqtt.broker_process import TestBroker

DEPLOY: Final = Path(__file__).parents[2] / "deploy"
LEFT_OUT: Final = {"numba", "polars", "scipy"}  # of a small install: the flow at the edge works without
PASSWORDS: Final = {"fingertip": "secret", "reader": "other"}  # by user


def settings(folder: Path) -> list[str]:
    """Return the shipped mosquitto.conf for a folder, without its listener; write the password file."""
    passwords, acl = folder / "passwords", folder / "acl"
    shutil.copy(DEPLOY / "mosquitto" / "acl", acl)
    acl.chmod(0o600)
    passwords.write_text("")
    passwords.chmod(0o600)
    for user, password in PASSWORDS.items():
        subprocess.run(["mosquitto_passwd", "-b", str(passwords), user, password], check=True)
    (folder / "data").mkdir()
    text = (DEPLOY / "mosquitto" / "mosquitto.conf").read_text()
    for place, here in (("/mosquitto/config/", f"{folder}/"), ("/mosquitto/data/", f"{folder}/data/")):
        assert place in text
        text = text.replace(place, here)
    listener = "listener 1883\n"
    assert listener in text
    text = text.replace(listener, "")  # TestBroker adds one on loopback
    nodelay = "set_tcp_nodelay true\n"
    assert nodelay in text
    return text.replace(nodelay, "").splitlines()  # TestBroker sets it


def shipped_broker(folder: Path) -> TestBroker:
    """Start a mosquitto with the shipped configuration."""
    return TestBroker(folder, *settings(folder))


def login(user: str | None, password: str | None = None) -> None:
    """Set the user and password (default: the correct one) for later connections."""
    password = PASSWORDS.get(user or "") if password is None else password
    for name, value in (("SLIPFLOW_MQTT_USER", user), ("SLIPFLOW_MQTT_PASSWORD", password)):
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
