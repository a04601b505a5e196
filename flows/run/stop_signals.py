"""Ctrl-C and SIGTERM as a wish to end, which the work that is told of it can meet in good order."""

import asyncio
import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def stopping() -> Generator[Callable[[], bool]]:
    """Gives what says whether somebody has asked to stop; who asks again ends the process at once.

    In a thread other than the main one nobody can ask.
    """
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked.is_set
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def ask(_number: int, _frame: FrameType | None) -> None:
        asked.set()
        restore()

    for number in before:
        signal.signal(number, ask)
    try:
        yield asked.is_set
    finally:
        restore()


@contextmanager
def signals_to(stop: Callable[[], None]) -> Generator[None]:
    """Let each SIGINT and SIGTERM call `stop` in the running event loop.

    In a thread other than the main one none can: whoever runs the loop there calls it.
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
