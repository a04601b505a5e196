"""Consumer that stores its events, as a process.

    python -m tests.chaos.follow URL POSITION LIST

Before it takes the next event, it appends a line to LIST, which survives a kill: time of the event (ns),
identifier, and time of arrival (ns).
"""

import asyncio
import os
import sys
import time
from pathlib import Path
from typing import NamedTuple

from connectors import Consumer


class Delivery(NamedTuple):
    """Line of the list."""

    time: int  # ns
    identifier: str
    arrival: int  # ns


def read(path: Path) -> list[Delivery]:
    """Return the stored events in order of arrival."""
    if not path.exists():
        return []
    *lines, _ = path.read_text().split("\n")  # the last one is empty or incomplete
    return [
        Delivery(int(first), identifier, int(arrival)) for first, identifier, arrival in map(str.split, lines)
    ]


def print_line(line: object) -> None:
    """Print a line and flush it."""
    print(line, flush=True)  # noqa: T201


async def main(url: str, position: str, kept: str) -> None:
    """Store events until killed."""
    file = os.open(kept, os.O_CREAT | os.O_WRONLY | os.O_APPEND)
    async with Consumer(url, since="start", position_file=position, report=print_line) as events:
        print_line("ready")
        async for event in events:
            os.write(file, f"{event.time} {event.identifier} {time.time_ns()}\n".encode())


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
