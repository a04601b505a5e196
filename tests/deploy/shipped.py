"""What deploy/ ships, as the tests and the benchmark use it."""

import os
import shutil
import subprocess
from pathlib import Path
from typing import Final

from tests.connectors.mqtt.broker_process import TestBroker

DEPLOY: Final = Path(__file__).parents[2] / "deploy"
PASSWORDS: Final = {"fingertip": "felt", "reader": "read"}  # by user


def settings(folder: Path) -> list[str]:
    """The shipped mosquitto.conf for a folder of one's own, without the listener; makes the passwords."""
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
    text = text.replace(listener, "")  # TestBroker has its own, on loopback
    nodelay = "set_tcp_nodelay true\n"
    assert nodelay in text
    return text.replace(nodelay, "").splitlines()  # which TestBroker sets, too


def shipped_broker(folder: Path) -> TestBroker:
    """A mosquitto with the shipped configuration."""
    return TestBroker(folder, *settings(folder))


def login(user: str | None, password: str | None = None) -> None:
    """Be a user of it, whose password is the right one by default."""
    password = PASSWORDS.get(user or "") if password is None else password
    for name, value in (("SLIPFLOW_MQTT_USER", user), ("SLIPFLOW_MQTT_PASSWORD", password)):
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
