"""Event loop in virtual time whose executor runs in the loop: one thread, one order of events per seed."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from random import Random
from typing import Any, Final, TypeVar

from flows.graph.testing import VirtualLoop
from operators.errors import SlipflowError
from tests.faults.simulated_process import SimulatedProcess, adopt

T = TypeVar("T")
LOOKS_MAX: Final = 1_000_000  # at the time, in a simulation


class SimulatedLoop(VirtualLoop):
    """Virtual-time loop with an inline executor.

    A function for the executor runs whole at some time within its latency; its result arrives at the end of
    it. `latency` (s) is drawn for each call, so that a slow disk delays the tasks that wait for it.
    """

    def __init__(self, random: Random) -> None:
        self._looks, self._unfinished = 0, set[asyncio.Task[Any]]()
        super().__init__()
        self._random = random
        self.failures: list[str] = []  # of tasks whose process was alive
        self.latency: Callable[[], float] = lambda: self._random.uniform(20e-6, 500e-6)

    def time(self) -> float:
        """Return the virtual time, s.

        Raises:
            AssertionError: if tasks keep each other busy.
        """
        self._looks += 1
        assert self._looks < LOOKS_MAX, "tasks keep each other busy"
        return super().time()

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
