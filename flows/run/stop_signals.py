"""Handlers that turn Ctrl-C and SIGTERM into a request for an orderly stop."""

import asyncio
import signal
from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import Any


@contextmanager
def signal_handlers(actions: Mapping[signal.Signals, Callable[[], None]]) -> Generator[None]:
    """Call an action in the running event loop on each of its signals; then restore the earlier handlers.

    `remove_signal_handler` alone would restore the default, which for most signals ends the process. Has no
    effect outside the main thread.
    """
    loop, before = asyncio.get_running_loop(), dict[signal.Signals, Any]()
    try:
        for number, action in actions.items():
            earlier = signal.getsignal(number)
            loop.add_signal_handler(number, action)
            before[number] = earlier
    except (RuntimeError, ValueError):  # not in the main thread
        pass
    try:
        yield
    finally:
        for number, earlier in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, earlier)


def signals_to(stop: Callable[[], None]) -> AbstractContextManager[None]:
    """Call `stop` in the running event loop on each SIGINT and SIGTERM.

    Has no effect outside the main thread.
    """
    return signal_handlers({signal.SIGINT: stop, signal.SIGTERM: stop})
