"""Simulated process: a set of tasks, links and file descriptors that a kill ends at once."""

import asyncio
from collections.abc import Callable, Coroutine
from contextvars import Context, ContextVar, copy_context
from typing import Any


class Killed(BaseException):
    """End of the simulated process: no later instruction of it has an effect."""


class SimulatedProcess:
    """Tasks started by `start`, and their links and files.

    Code finds its process with `current`. After `kill`, each access to disk or network raises `Killed`, so
    that `finally` blocks and background tasks of the killed process change nothing.
    """

    def __init__(self, name: str) -> None:
        self.name, self.alive = name, True
        self.on_kill: list[Callable[[], object]] = []  # close links and files, as the operating system does
        self.tasks: dict[asyncio.Task[Any], None] = {}  # that have not ended, in order of their start
        self._context: Context = copy_context()
        self._context.run(_CURRENT.set, self)

    def start(self, main: Coroutine[Any, Any, Any]) -> "asyncio.Task[Any]":
        """Start the main task; tasks that it creates inherit the process."""
        return asyncio.get_running_loop().create_task(main, context=self._context)

    def run(self, call: Callable[[], object]) -> None:
        self._context.run(call)

    def kill(self) -> None:
        """End the process as SIGKILL does."""
        if not self.alive:
            return
        self.alive = False
        for call in self.on_kill:
            call()
        for task in list(self.tasks):
            task.cancel()


def adopt(task: "asyncio.Task[Any]", context: Context | None) -> SimulatedProcess | None:
    """Let a new task end with the process of its context, by default the running one; return the process."""
    process = _CURRENT.get() if context is None else context.get(_CURRENT)
    if process:
        process.tasks[task] = None
    return process


_CURRENT: ContextVar[SimulatedProcess | None] = ContextVar("process", default=None)


def process_of_context() -> SimulatedProcess | None:
    """Return the process of the running code, which may have been killed; None for the observer."""
    return _CURRENT.get()


def current() -> SimulatedProcess | None:
    """Return the process of the running code; None for the observer, which no fault affects.

    Raises:
        Killed: if the process was killed.
    """
    process = _CURRENT.get()
    if process and not process.alive:
        raise Killed(process.name)
    return process
