"""State messages to systemd (sd_notify protocol)."""

import os
import socket
from contextlib import suppress
from typing import Final

READY: Final = "READY=1"  # the service has started
ALIVE: Final = "WATCHDOG=1"  # the service works
STOPPING: Final = "STOPPING=1"  # the service ends; the watchdog stops


def notify_systemd(state: str) -> None:
    """Send a state to the service manager named by NOTIFY_SOCKET; do nothing without one, and never wait."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if address.startswith(("/", "@")):
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.setblocking(False)  # noqa: FBT003 - socket's signature
            channel.sendto(state.encode(), address.replace("@", "\0", 1) if address[0] == "@" else address)
