"""Signal handlers for the time in which an arm moves."""

import asyncio
import signal
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import Any


@contextmanager
def signal_handlers(actions: Mapping[signal.Signals, Callable[[], None]]) -> Generator[None]:
    """Open a block of a running event loop in which signals call actions; then restore the earlier handlers.

    `remove_signal_handler` alone restores the default, which for most signals ends the process. Outside the
    main thread, which alone receives signals, nothing is changed.
    """
    loop, before = asyncio.get_running_loop(), dict[signal.Signals, Any]()
    try:
        for number, action in actions.items():
            earlier = signal.getsignal(number)
            loop.add_signal_handler(number, action)
            before[number] = earlier
    except (RuntimeError, ValueError):  # not the main thread
        pass
    try:
        yield
    finally:
        for number, earlier in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, earlier)
