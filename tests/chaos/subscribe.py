"""An independent subscriber, mosquitto_sub, that notes what comes and when."""

import subprocess
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from operators import s


class Came(NamedTuple):
    """A message that came."""

    at: int  # ns
    topic: str
    payload: bytes


@contextmanager
def subscribed(port: int, topic: str, path: Path) -> Generator[None]:
    """Note in a file what comes on a topic."""
    command = ["mosquitto_sub", "-h", "127.0.0.1", "-p", str(port), "-V", "mqttv5", "-q", "1", "-t", topic]
    with path.open("wb") as file:
        process = subprocess.Popen([*command, "-F", "%U %t %p"], stdout=file)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def came(path: Path) -> list[Came]:
    """What was noted."""
    *lines, _ = path.read_bytes().split(b"\n")
    found = list[Came]()
    for line in lines:
        at, topic, payload = line.split(b" ", 2)
        seconds, _, nanoseconds = at.partition(b".")
        found.append(Came(int(seconds) * s + int(nanoseconds), topic.decode(), payload))
    return found
