"""Handlers that turn Ctrl-C and SIGTERM into a request for an orderly stop."""

import asyncio
import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def stopping() -> Generator[Callable[[], bool]]:
    """Yield a function that returns True after the first SIGINT or SIGTERM; the second one ends the process.

    Has no effect outside the main thread.
    """
    requested = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield requested.is_set
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def request_stop(_number: int, _frame: FrameType | None) -> None:
        requested.set()
        restore()

    for number in before:
        signal.signal(number, request_stop)
    try:
        yield requested.is_set
    finally:
        restore()


@contextmanager
def signals_to(stop: Callable[[], None]) -> Generator[None]:
    """Call `stop` in the running event loop on each SIGINT and SIGTERM.

    Has no effect outside the main thread.
    """
    loop = asyncio.get_running_loop()
    caught: list[signal.Signals] = []
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, stop)
            caught.append(number)
    except (RuntimeError, ValueError):  # not in the main thread
        pass
    try:
        yield
    finally:
        for number in caught:
            loop.remove_signal_handler(number)
