"""Independent subscriber, mosquitto_sub, which stores messages and their times."""

import subprocess
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from operators import s


class Received(NamedTuple):
    """Message that arrived."""

    at: int  # ns
    topic: str
    payload: bytes


@contextmanager
def subscribed(port: int, topic: str, path: Path) -> Generator[None]:
    """Store the messages of a topic in a file."""
    command = ["mosquitto_sub", "-h", "127.0.0.1", "-p", str(port), "-V", "mqttv5", "-q", "1", "-t", topic]
    with path.open("wb") as file:
        process = subprocess.Popen([*command, "-F", "%U %t %p"], stdout=file)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def received(path: Path) -> list[Received]:
    """Return the stored messages."""
    *lines, _ = path.read_bytes().split(b"\n")
    found = list[Received]()
    for line in lines:
        at, topic, payload = line.split(b" ", 2)
        seconds, _, nanoseconds = at.partition(b".")
        found.append(Received(int(seconds) * s + int(nanoseconds), topic.decode(), payload))
    return found
