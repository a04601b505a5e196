"""Client of the process that commands a UR arm."""

import asyncio
from collections.abc import Callable
from contextlib import ExitStack, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Final

from connectors.ur.control_process import Command, Reply, Signal, serve

START_TIMEOUT: Final = 30.0  # s; the process imports ur-rtde and uploads a program
HUNG: Final = 2.0  # s without a reply, after which the process counts as hung
_KEEP_ALIVE: Final = 0.1  # s between keep-alive messages


class ControlClient:
    """Client that starts, commands, monitors and ends the process.

    Args:
        host: Address of the controller.
        watchdog: Minimum rate of writes that the controller requires, Hz.
        changed: Called when the process is ready.
        failed: Called with a reason when the process fails, dies or hangs.

    Attributes:
        process: The process; None before `start` and after `close`.
        ready: True once the controller accepts commands.
        ended: Event, set once the process can receive no more commands.
    """

    def __init__(
        self, host: str, watchdog: float, changed: Callable[[], None], failed: Callable[[str], None]
    ) -> None:
        self.process: SpawnProcess | None = None
        self.ready, self.ended = False, asyncio.Event()
        self._host, self._watchdog, self._changed, self._failed = host, watchdog, changed, failed
        self._pipe: Connection | None = None
        self._closing = False
        self._replied = 0.0  # loop time (s) of the newest reply

    def start(self) -> None:
        """Start the process."""
        context = get_context("spawn")  # a fork would inherit the event loop and threads
        ours, theirs = context.Pipe()
        process = context.Process(
            target=serve, args=(theirs, self._host, self._watchdog), name=f"arm {self._host}", daemon=True
        )
        with theirs, ExitStack() as failing:
            failing.enter_context(ours)  # closed if the process cannot be started
            process.start()
            failing.pop_all()
        self._pipe, self.process = ours, process
        loop = asyncio.get_running_loop()
        self._replied = loop.time() + START_TIMEOUT
        loop.add_reader(self._pipe.fileno(), self._read_replies)

    def send(self, command: Command) -> None:
        """Send a command; without a process it has no effect."""
        if self._pipe:
            with suppress(OSError):  # the process has died; `_read_replies` reports it
                self._pipe.send(command)

    async def keep_alive(self) -> None:
        """Send keep-alive messages to the process, and check its replies, until it ends."""
        loop = asyncio.get_running_loop()
        while not self.ended.is_set():
            self.send(Signal.KEEP_ALIVE)
            if loop.time() - self._replied > HUNG:
                self._failed(f"the process that commands it has not replied for {HUNG} s")
            await asyncio.sleep(_KEEP_ALIVE)

    async def close(self) -> None:
        """End the process; kill it if it does not end in time."""
        if not (process := self.process):
            return
        self._closing = True
        self.send(Signal.END)
        with suppress(TimeoutError):
            async with asyncio.timeout(HUNG):
                await self.ended.wait()
        self.process = None
        if not self.ended.is_set():
            process.kill()
        await asyncio.to_thread(process.join, HUNG)
        self._close_pipe()

    def _read_replies(self) -> None:
        assert self._pipe
        try:
            while self._pipe.poll():
                reply: Reply = self._pipe.recv()
                self._replied = asyncio.get_running_loop().time()
                if reply.kind == "ready":
                    self.ready = True
                    self._changed()
                elif reply.kind == "failed":
                    self._failed(reply.text)
        except (EOFError, OSError):
            self._close_pipe()
            if not self._closing:
                self._failed(
                    "the process that commands it died; the controller's watchdog also stops the arm"
                )

    def _close_pipe(self) -> None:
        self.ended.set()
        if self._pipe:
            asyncio.get_running_loop().remove_reader(self._pipe.fileno())
            self._pipe.close()
            self._pipe = None
