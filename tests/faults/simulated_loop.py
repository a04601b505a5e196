"""Event loop in virtual time whose executor runs in the loop: one thread, one order of events per seed."""

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from heapq import heappop, heappush
from itertools import count
from random import Random
from typing import Any, Final, TypeVar

from flows.graph.testing import VirtualLoop
from operators.errors import SlipflowError
from tests.faults.simulated_process import SimulatedProcess, adopt

T = TypeVar("T")
TURNS_MAX: Final = 1_000_000  # of the loop in a simulation


class SimulatedLoop(VirtualLoop):
    """Virtual-time loop with an inline executor.

    A function for the executor runs whole at some time within its latency; its result arrives at the end of
    it. `latency` (s) is drawn for each call, so that a slow disk delays the tasks that wait for it.
    """

    _ready: deque[asyncio.Handle]  # of asyncio's loop, like the next
    _clock_resolution: float

    def __init__(self, random: Random) -> None:
        super().__init__()
        self._random = random
        self._turns, self._unfinished = 0, set[asyncio.Task[Any]]()
        self._timers, self._numbers = list[tuple[float, int, asyncio.TimerHandle]](), count()
        self.failures: list[str] = []  # of tasks whose process was alive
        self.latency: Callable[[], float] = lambda: self._random.uniform(20e-6, 500e-6)

    def _run_once(self) -> None:
        """Run the callbacks that are due, like asyncio's method, but without sockets, signals and threads.

        Raises:
            AssertionError: if tasks keep each other busy.
        """
        ready, timers = self._ready, self._timers
        if not ready and timers:
            self._virtual.time = max(self._virtual.time, timers[0][0])
        due = self._virtual.time + self._clock_resolution
        while timers and (timers[0][0] < due or timers[0][2].cancelled()):
            ready.append(heappop(timers)[2])
        self._turns += 1
        assert self._turns < TURNS_MAX, "tasks keep each other busy"
        for _ in range(len(ready)):
            handle = ready.popleft()
            if not handle.cancelled():
                handle._run()

    def call_at(self, when: float, callback: Any, *args: Any, context: Any = None) -> asyncio.TimerHandle:  # type: ignore[override]
        """Call a function at a time; of equal times in the order of the calls."""
        timer = asyncio.TimerHandle(when, callback, args, self, context)
        heappush(self._timers, (when, next(self._numbers), timer))  # asyncio compares handles, which is slow
        return timer

    def call_soon(self, callback: Any, *args: Any, context: Any = None) -> asyncio.Handle:  # type: ignore[override]
        """Call a function in the next turn, as asyncio's method without its checks."""
        self._ready.append(handle := asyncio.Handle(callback, args, self, context))
        return handle

    def create_task(self, coro: Any, **options: Any) -> "asyncio.Task[Any]":
        """Create a task that belongs to the process of its context."""
        task = super().create_task(coro, **options)
        self._unfinished.add(task)  # else those of a killed process end whenever garbage is collected
        task.add_done_callback(partial(self._note_end, adopt(task, options.get("context"))))
        return task

    def close(self) -> None:
        """Close the loop; first end what is left of tasks, whose `finally` blocks may fail or wait again."""
        for task in list(self._unfinished):
            coroutine: Any = task.get_coro()
            for _ in range(10):
                with suppress(Exception):
                    coroutine.close()
        super().close()

    def _note_end(self, process: SimulatedProcess | None, task: "asyncio.Task[Any]") -> None:
        self._unfinished.discard(task)
        if not process:
            return
        process.tasks.pop(task, None)
        error = None if task.cancelled() else task.exception()
        if process.alive and error and not isinstance(error, SlipflowError):
            self.failures.append(f"a task of the {process.name} died: {task.get_coro()}: {error!r}")

    def run_in_executor(self, executor: Any, func: Callable[..., T], *args: Any) -> "asyncio.Future[T]":  # type: ignore[override]
        """Run a function later in the loop; cancelling the future does not stop it, as with a thread."""
        future: asyncio.Future[T] = self.create_future()
        latency = self.latency()
        start = self._random.random() * latency

        def run() -> None:
            try:
                result = func(*args)
            except BaseException as error:  # noqa: BLE001 - carried to the waiting task
                self.call_later(latency - start, _fail, future, error)
            else:
                self.call_later(latency - start, _finish, future, result)

        self.call_later(start, run)
        return future


def _finish(future: "asyncio.Future[T]", result: T) -> None:
    if not future.done():
        future.set_result(result)


def _fail(future: "asyncio.Future[Any]", error: BaseException) -> None:
    if not future.done():
        future.set_exception(error)
