"""A real broker and an independent subscriber for tests: mosquitto, mosquitto_sub and mosquitto_pub."""

import os
import secrets
import shutil
import signal
import socket
import subprocess
import time
from errno import ECONNREFUSED
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import NamedTuple, Self
from uuid import uuid4

from connectors.mqtt.broker import Message
from connectors.mqtt.broker_link import Link
from operators.errors import EndpointError
from tests.waiting import PATIENCE


async def deliver(link: Link, topic: str, payload: bytes = b"x", *, retain: bool = False) -> None:
    """Publish a message on a link, and wait until the broker has it.

    Raises:
        EndpointError: if the broker refuses it.
    """
    [refusal] = await link.send_all([Message(topic, payload, retain)])
    if refusal:
        raise EndpointError(topic, refusal)


class Received(NamedTuple):
    """A message received by a subscriber."""

    topic: str
    payload: str
    retained: bool  # True: the broker had stored it before
    content_type: str = ""


class TestListener:
    """A mosquitto_sub process."""

    __test__ = False

    def __init__(self, port: int, *topics: str) -> None:
        """Subscribe to topic filters of a broker on loopback; return once the subscription is active."""
        self._port, self._marker = port, f"test/{uuid4()}"
        _publish(port, self._marker, "ready", "-r")
        filters = [word for topic in (self._marker, *topics) for word in ("-t", topic)]
        command = ["mosquitto_sub", *_options(port), *filters, "-F", "%r %C %t %p"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self._received = Queue[Received]()
        self._reader = Thread(target=self._read)
        self._reader.start()
        self.next(self._marker)

    def next(self, topic: str | None = None) -> Received:
        """Wait for the next message, or the next on `topic`, and return it."""
        while True:
            received = self._received.get(timeout=PATIENCE)
            if topic in (None, received.topic):
                return received

    def rest(self) -> list[Received]:
        """Return all messages received so far and not yet returned, in order."""
        _publish(self._port, self._marker, "end")
        found = list[Received]()
        while (received := self.next()).topic != self._marker:
            found.append(received)
        return found

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        self._reader.join()

    def _read(self) -> None:
        assert self._process.stdout
        with self._process.stdout as lines:
            for line in lines:
                retained, content_type, topic, payload = line.rstrip("\n").split(" ", 3)
                self._received.put(Received(topic, payload, retained == "1", content_type))


class TestBroker:
    """A mosquitto process on a free loopback port; it loses retained messages when it stops."""

    __test__ = False

    def __init__(self, folder: Path, *settings: str) -> None:
        """Start with files in `folder`; `settings` of mosquitto.conf replace ``allow_anonymous true``."""
        program = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
        if not (program and shutil.which("mosquitto_sub")):
            raise EndpointError("mosquitto", "not found: apt-get install mosquitto mosquitto-clients")
        self.port = _free_port()
        self._log, config = folder / "mosquitto.log", folder / "mosquitto.conf"
        user = ["user root"] if os.geteuid() == 0 else []
        lines = [f"listener {self.port} 127.0.0.1", "set_tcp_nodelay true", *user]
        config.write_text("\n".join([*lines, *(settings or ["allow_anonymous true"]), ""]))
        self._command = [program, "-c", str(config)]
        self.process: subprocess.Popen[bytes] | None = None
        self._listeners: list[TestListener] = []
        self.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """URL of the broker."""
        return f"mqtt://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Start the process, also after `stop`, and wait until it listens."""
        with self._log.open("ab") as log:
            self.process = subprocess.Popen(self._command, stdout=log, stderr=log)
        end = time.monotonic() + PATIENCE
        while self.process.poll() is None and time.monotonic() < end:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.005)
        raise EndpointError("mosquitto", f"does not start: {self._log.read_text()}")

    def stop(self, number: signal.Signals = signal.SIGKILL) -> None:
        """End the process with a signal."""
        if self.process:
            self.process.send_signal(number)
            self.process.wait()
            self.process = None

    def publish(self, topic: str, payload: str, *options: str) -> None:
        """Publish with mosquitto_pub."""
        _publish(self.port, topic, payload, *options)

    def listen(self, *topics: str) -> TestListener:
        """Return a subscriber, which `close` ends."""
        self._listeners.append(listener := TestListener(self.port, *topics))
        return listener

    def close(self) -> None:
        """End the broker and its subscribers."""
        for listener in self._listeners:
            listener.close()
        self.stop()


def _free_port() -> int:
    """Return a free port outside the range from which the system assigns ports."""
    while True:
        with socket.socket() as probe:
            port = 10_000 + secrets.randbelow(22_000)
            if probe.connect_ex(("127.0.0.1", port)) == ECONNREFUSED:
                return port


def _publish(port: int, topic: str, payload: str, *options: str) -> None:
    command = ["mosquitto_pub", *_options(port), "-t", topic, "-m", payload, *options]
    subprocess.run(command, check=True)


def _options(port: int) -> list[str]:
    return ["-h", "127.0.0.1", "-p", str(port), "-V", "mqttv5", "-q", "1"]
