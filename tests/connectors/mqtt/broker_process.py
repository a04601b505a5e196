"""Aids for testing what speaks MQTT: a real broker of one's own, and an independent subscriber."""

import asyncio
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import NamedTuple, Self
from uuid import uuid4

from operators.errors import EndpointError

PATIENCE = 10.0  # s, for what another process must do


async def until(condition: Callable[[], bool]) -> None:
    """Wait until something is so that another thread, task or process brings about.

    Raises:
        TimeoutError: if it is not within 10 s.
    """
    async with asyncio.timeout(PATIENCE):
        while not condition():  # noqa: ASYNC110 - what brings it about knows no event loop
            await asyncio.sleep(0.01)


class Received(NamedTuple):
    """A message as a subscriber sees it."""

    topic: str
    payload: str
    retained: bool  # True: the broker had it before


class TestListener:
    """A mosquitto_sub whose messages are read as they come."""

    __test__ = False

    def __init__(self, port: int, *topics: str) -> None:
        """Subscribe to topic filters of a broker on loopback, and to a topic of its own below ``test``."""
        self._port, self._mark = port, f"test/{uuid4()}"
        _publish(port, self._mark, "ready", "-r")
        filters = [word for topic in (self._mark, *topics) for word in ("-t", topic)]
        command = ["mosquitto_sub", *_where(port), *filters, "-F", "%r %t %p"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self._received = Queue[Received]()
        self._reader = Thread(target=self._read)
        self._reader.start()
        self.next(self._mark)  # so the subscription is there

    def next(self, topic: str | None = None) -> Received:
        """The next message, or the next on `topic`, waiting for it.

        Raises:
            queue.Empty: if none comes within 10 s.
        """
        while True:
            received = self._received.get(timeout=PATIENCE)
            if topic in (None, received.topic):
                return received

    def rest(self) -> list[Received]:
        """All that has come and was not yet asked for, in order.

        Raises:
            queue.Empty: if the broker brings nothing within 10 s.
        """
        _publish(self._port, self._mark, "end")
        found = list[Received]()
        while (received := self.next()).topic != self._mark:
            found.append(received)
        return found

    def close(self) -> None:
        """Unsubscribe."""
        self._process.kill()
        self._process.wait()
        self._reader.join()

    def _read(self) -> None:
        assert self._process.stdout
        with self._process.stdout as lines:
            for line in lines:
                retained, topic, payload = line.rstrip("\n").split(" ", 2)
                self._received.put(Received(topic, payload, retained == "1"))


class TestBroker:
    """A mosquitto of one's own on a free loopback port; what it retains is lost when it stops.

    Used in a ``with`` block, it is closed at the end.
    """

    __test__ = False

    def __init__(self, folder: Path, *settings: str) -> None:
        """Start it, with its files in `folder`; lines of mosquitto.conf replace ``allow_anonymous true``.

        Raises:
            EndpointError: if mosquitto is not installed or does not start.
        """
        self._program = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
        if not (self._program and shutil.which("mosquitto_sub")):
            raise EndpointError("mosquitto", "not found: apt-get install mosquitto mosquitto-clients")
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port: int = free.getsockname()[1]
        self._log, self._config = folder / "mosquitto.log", folder / "mosquitto.conf"
        user = ["user root"] if os.geteuid() == 0 else []
        lines = [f"listener {self.port} 127.0.0.1", "set_tcp_nodelay true", *user]
        self._config.write_text("\n".join([*lines, *(settings or ["allow_anonymous true"]), ""]))
        self.process: subprocess.Popen[bytes] | None = None
        self._listeners: list[TestListener] = []
        self.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """Its address."""
        return f"mqtt://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Start it, again after `stop`; returns once it listens.

        Raises:
            EndpointError: if it does not start, with what its log says.
        """
        assert self._program
        with self._log.open("ab") as log:
            command = [self._program, "-c", str(self._config)]
            self.process = subprocess.Popen(command, stdout=log, stderr=log)
        for _ in range(500):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            if self.process.poll() is not None:
                break
            time.sleep(PATIENCE / 500)
        raise EndpointError("mosquitto", f"does not start: {self._log.read_text()}")

    def stop(self, number: signal.Signals = signal.SIGKILL) -> None:
        """Stop it with a signal."""
        if self.process:
            self.process.send_signal(number)
            self.process.wait()
            self.process = None

    def publish(self, topic: str, payload: str, *options: str) -> None:
        """Publish with mosquitto_pub."""
        _publish(self.port, topic, payload, *options)

    def listen(self, *topics: str) -> TestListener:
        """A subscriber, which `close` closes."""
        self._listeners.append(listener := TestListener(self.port, *topics))
        return listener

    def close(self) -> None:
        """Stop it and its subscribers."""
        for listener in self._listeners:
            listener.close()
        self.stop()


def _publish(port: int, topic: str, payload: str, *options: str) -> None:
    command = ["mosquitto_pub", *_where(port), "-t", topic, "-m", payload, *options]
    subprocess.run(command, check=True)


def _where(port: int) -> list[str]:
    return ["-h", "127.0.0.1", "-p", str(port), "-V", "mqttv5", "-q", "1"]
