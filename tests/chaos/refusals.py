"""Brokers that refuse the rig: errors with a remedy, and no event lost."""

import asyncio
import os
import subprocess
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager, chdir
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from unittest import mock

from connectors import Event, Mqtt
from connectors.mqtt.broker import CA, PASSWORD, USER
from connectors.mqtt.outbox import Outbox
from operators import Run, SlipflowError
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.connectors.mqtt.broker_process import TestBroker

BOUND = 3.0  # s
EVENTS = 5  # in the outbox
DRAFT = Event("chaos", "rig", "0", "", 0, onset=True, time=1, probability=0.9, latency=1.0)


class Clock:
    """Clock of the host."""

    def now(self) -> int:
        """Return the time, ns."""
        return time.time_ns()

    async def sleep_until(self, time: int) -> None:
        """Fail: nothing waits."""
        raise AssertionError(time)


class Case(NamedTuple):
    """Broker, how it is addressed, and text that the error must contain."""

    name: str
    settings: Callable[[Path], list[str]]  # of the broker, with its files in a folder
    environment: dict[str, str]
    scheme: str
    remedy: str  # text of the error


def with_passwords(folder: Path) -> list[str]:
    """Return settings with one user, rig, that may not publish."""
    subprocess.run(["mosquitto_passwd", "-c", "-b", folder / "users", "rig", "right"], check=True)
    (folder / "rights").write_text("user rig\ntopic read #\n")
    return ["allow_anonymous false", f"password_file {folder}/users", f"acl_file {folder}/rights"]


def with_tls(folder: Path) -> list[str]:
    """Return settings with TLS and a certificate of an unknown authority."""
    for name in ("ours", "other"):
        kind = ["-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=test"]
        files = ["-keyout", f"{folder}/{name}.key", "-out", f"{folder}/{name}.pem"]
        address = ["-addext", "subjectAltName=IP:127.0.0.1"]
        subprocess.run(["openssl", "req", *kind, *address, *files], check=True, capture_output=True)
    return ["allow_anonymous true", f"certfile {folder}/ours.pem", f"keyfile {folder}/ours.key"]


def anonymous(_: Path) -> list[str]:
    """Return settings without users."""
    return ["allow_anonymous true"]


CASES = (
    Case("wrong password", with_passwords, {USER: "rig", PASSWORD: "wrong"}, "mqtt", f"check {USER}"),
    Case("ACL", with_passwords, {USER: "rig", PASSWORD: "right"}, "mqtt", "access list"),
    Case("wrong CA", with_tls, {CA: "other.pem"}, "mqtts", CA),
    Case("plain TCP on a TLS port", with_tls, {}, "mqtt", "mqtts://"),
    Case("TLS on a plain port", anonymous, {}, "mqtts", "mqtt://"),
)


def refusals(scale: Scale) -> list[Promise]:
    """Try to publish with events in the outbox."""
    bound = 3 * BOUND if scale.short else BOUND  # the machine may be busy while the suite runs
    found = list[Promise]()
    for case in CASES:
        with TemporaryDirectory(prefix="slipflow-chaos-") as name:
            folder = Path(name)
            broker = TestBroker(folder, *case.settings(folder))
            try:
                with mock.patch.dict(os.environ, case.environment), chdir(folder):
                    url = broker.url.replace("mqtt:", f"{case.scheme}:")
                    duration, error, events = asyncio.run(_refused(url, folder / "outbox"))
            finally:
                broker.close()
        result = f"after {duration:.2f} s: {error.partition(': ')[2]}; {events} events kept"
        bound_text = f"an error within {BOUND:.0f} s that says what to do, {EVENTS} kept"
        passed = duration < bound and case.remedy in error and events == EVENTS
        found.append(
            Promise(f"events: {case.name}, {EVENTS} events in the outbox", result, bound_text, passed=passed)
        )
    return found


async def _refused(url: str, path: Path) -> tuple[float, str, int]:
    """Return duration (s), error, and number of events that are still in the outbox."""
    async with _opened(path) as outbox:
        await outbox.append([DRAFT] * EVENTS)
    sink, error, began = Mqtt(url, "chaos", "rig", outbox=path), "none", time.monotonic()
    try:
        await sink.open(Run("chaos", "chaos", Clock(), 0))
        await sink.close()
    except SlipflowError as raised:
        error = str(raised)
    duration = time.monotonic() - began
    async with _opened(path) as outbox:
        return duration, error, outbox.waiting


@asynccontextmanager
async def _opened(path: Path) -> AsyncGenerator[Outbox]:
    outbox = Outbox(path)
    await outbox.open()
    try:
        yield outbox
    finally:
        await outbox.close()


PROMISES = [refusals]
