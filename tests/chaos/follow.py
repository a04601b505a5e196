"""A consumer in a process of its own, which keeps what it was given.

    python -m tests.chaos.follow URL POSITION LIST

Each event is a line of LIST, which no kill can take back, before the next is taken: its time, its identifier,
and when it came (ns).
"""

import asyncio
import os
import sys
import time
from pathlib import Path
from typing import NamedTuple

from connectors import Consumer


class Had(NamedTuple):
    """A line of the list."""

    time: int  # ns
    identifier: str
    came: int  # ns


def read(path: Path) -> list[Had]:
    """What was kept so far, in the order in which it came."""
    if not path.exists():
        return []
    *lines, _ = path.read_text().split("\n")  # the last one is empty, or not whole
    return [Had(int(first), identifier, int(came)) for first, identifier, came in map(str.split, lines)]


def say(line: object) -> None:
    """Print a line at once."""
    print(line, flush=True)  # noqa: T201 - that is its job


async def main(url: str, position: str, kept: str) -> None:
    """Follow for ever."""
    file = os.open(kept, os.O_CREAT | os.O_WRONLY | os.O_APPEND)
    async with Consumer(url, since="start", position_file=position, report=say) as events:
        say("ready")
        async for event in events:
            os.write(file, f"{event.time} {event.identifier} {time.time_ns()}\n".encode())


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
