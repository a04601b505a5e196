"""The terminal or service manager that supervises a run: its signals, and state messages to systemd."""

import asyncio
import os
import signal
import socket
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from typing import Any, Final

READY: Final = "READY=1"  # the service has started
ALIVE: Final = "WATCHDOG=1"  # the service works
STOPPING: Final = "STOPPING=1"  # the service ends; the watchdog stops


@contextmanager
def signals_to(stop: Callable[[], None]) -> Generator[None]:
    """Call `stop` in the running event loop on each Ctrl-C, SIGTERM and SIGHUP; then restore the handlers.

    A terminal that closes sends SIGHUP; under nohup it stays ignored. `remove_signal_handler` alone would
    restore the default, which for most signals ends the process. Has no effect outside the main thread.
    """
    loop, before = asyncio.get_running_loop(), dict[signal.Signals, Any]()
    with suppress(RuntimeError, ValueError):  # not in the main thread
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            earlier = signal.getsignal(number)
            if number != signal.SIGHUP or earlier != signal.SIG_IGN:
                loop.add_signal_handler(number, stop)
                before[number] = earlier
    try:
        yield
    finally:
        for number, earlier in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, earlier)


def notify_systemd(state: str) -> None:
    """Send a state to the service manager named by NOTIFY_SOCKET; do nothing without one, and never wait."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if address.startswith(("/", "@")):
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.setblocking(False)
            channel.sendto(state.encode(), address.replace("@", "\0", 1) if address[0] == "@" else address)
