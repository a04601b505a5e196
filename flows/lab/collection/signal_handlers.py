"""What a signal does while an arm is driven, and that it does as before afterwards."""

import asyncio
import signal
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import Any


@contextmanager
def answered(acts: Mapping[signal.Signals, Callable[[], None]]) -> Generator[None]:
    """A block of a running event loop in which signals call acts; then they do what they did before.

    The loop's own way ends with the default, which for most signals is the end of the process. Outside of the
    main thread, which alone gets signals, nothing is changed.
    """
    loop, before = asyncio.get_running_loop(), dict[signal.Signals, Any]()
    try:
        for number, act in acts.items():
            earlier = signal.getsignal(number)
            loop.add_signal_handler(number, act)
            before[number] = earlier
    except (RuntimeError, ValueError):  # not the main thread
        pass
    try:
        yield
    finally:
        for number, earlier in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, earlier)
