"""Bounded queue of a sink in a live run, with the task that empties it and its retries."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from math import inf
from typing import Any, Final

from flows.graph.node import location
from flows.run.failures import MISTAKES, contained, reason_of
from operators.batch import Batch
from operators.errors import EndpointError, OutputClosedError
from operators.ports import BackOff, Sink, SinkStatus

LAST_ATTEMPTS: Final = 5.0  # s; a failing sink is retried for this time after the end of the run
STUCK: Final = 10.0  # s; a sink whose write takes longer counts as failing until it ends
GRACE: Final = 2.0  # s; an abandoned sink may end its write and close for this time

log = logging.getLogger("slipflow")


class SinkQueue:
    """Queue of a sink, and the task that empties it.

    A batch that the sink takes at once is not queued, unless others wait before it. A failed write is
    retried with the same batch. While a lossless sink is slow, the sources wait for room; while it fails or
    is stuck, new batches without room are dropped and counted. Other sinks never make sources wait: their
    oldest batch is dropped. When the sink raises `OutputClosedError` or one of `MISTAKES`, its further
    batches are dropped, and `on_closed` is called.
    """

    def __init__(self, name: str, sink: Sink[Any], on_closed: Callable[[], object] = lambda: None) -> None:
        self.name, self.sink, self._on_closed = name, sink, on_closed
        self.status = SinkStatus(records=sink.records)
        self.mistake: Exception | None = None  # in the code of the sink; `status.error` has its place
        self._waiting: deque[Batch] = deque()
        self._idle = True  # nothing is queued or being written
        self._more, self._room = asyncio.Event(), asyncio.Event()
        self._end, self._abandoned = asyncio.Event(), asyncio.Event()
        self._write_start: float | None = None  # loop time, s; None: no write in progress
        self._dropped_before = 0  # rows, before the current failure
        self._task: asyncio.Task[None] | None = None
        self._cancelling: asyncio.TimerHandle | None = None

    @property
    def backlog(self) -> str:
        """Text about the rows that the sink has not stored yet."""
        return f"{self.name} ({self.status.queued} batches queued, {self.sink.pending} rows not stored)"

    def try_put(self, batch: Batch) -> bool:
        """Write, queue or drop a batch by the sink's policy; return False if there is no room."""
        if self._idle and not self._abandoned.is_set() and self._take(batch):
            return True
        if self._abandoned.is_set():
            self._drop(batch)
            return True
        if len(self._waiting) >= self.sink.capacity:
            if not self.sink.lossless:
                self._drop(self._waiting.popleft())
            elif self._is_failing():  # waiting would block the other sinks
                self._drop(batch)
                return True
            else:
                return False
        self._waiting.append(batch)
        self.status.queued = len(self._waiting)
        self._idle = False
        self._more.set()
        return True

    async def put(self, batch: Batch) -> None:
        """Queue a batch; wait for room if necessary."""
        while not self.try_put(batch):
            self._room.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(STUCK):
                    await self._room.wait()

    def observe(self) -> None:
        """Update the status: connection, unacknowledged and unstored rows, a write that takes too long."""
        self._is_failing()
        self.status.waiting, self.status.connected = self.sink.waiting, self.sink.connected
        self.status.unstored = 0 if self._task and self._task.done() else self.sink.pending

    def start(self) -> asyncio.Task[None]:
        """Start the task that writes the queued batches and closes the sink; it raises no error."""
        self._task = asyncio.create_task(self._run())
        return self._task

    def complete(self) -> None:
        """End the queue: no more batches follow."""
        self._end.set()
        self._more.set()

    def abandon(self) -> None:
        """Drop the queued batches and stop retrying; cancel the task if it does not end within `GRACE`."""
        if self._task and not self._cancelling:  # once: a second time would interrupt its last write
            self._cancelling = asyncio.get_running_loop().call_later(GRACE, self._task.cancel)
        self._abandoned.set()
        self._drop_waiting()
        self._room.set()

    async def _run(self) -> None:
        try:
            while self._waiting or not self._end.is_set():
                if not self._waiting:
                    self._idle = True
                    self._more.clear()
                    await self._more.wait()
                    continue
                batch = self._waiting.popleft()
                self.status.queued = len(self._waiting)
                self._room.set()
                await self._write(batch)
            with contained():
                await self.sink.close()
        except asyncio.CancelledError:
            self._drop_waiting()
            self._failed(EndpointError(self.sink.destination, "was abandoned before it had stored its rows"))
        except Exception as error:  # noqa: BLE001 - the other sinks must be closed too
            self._failed(error)
        finally:
            self._abandoned.set()  # nothing is written any more
            lost = self.sink.pending
            self.status.rows -= lost
            self.status.dropped += lost
            waiting = self.sink.waiting
            self.status.waiting = None if waiting is None else max(0, waiting - lost)
            self.status.unstored = 0
            self._room.set()

    def _take(self, batch: Batch) -> bool:
        """Return True if the sink took the batch at once; after an error, `write` tries again."""
        try:
            taken = self.sink.take(batch)
        except Exception as error:  # noqa: BLE001 - no error of a sink may stop the others
            self._failed(error)
            return False
        if taken:
            self._wrote(batch)
        return taken

    async def _write(self, batch: Batch) -> None:
        """Write a batch; retry until it is written or abandoned."""
        loop, retry, deadline = asyncio.get_running_loop(), BackOff(), inf
        while True:
            self._write_start = loop.time()
            try:
                with contained():
                    await self.sink.write(batch)
            except asyncio.CancelledError:
                self.status.dropped += len(batch)
                raise
            except Exception as error:  # noqa: BLE001 - no error of a sink may stop the others
                self._failed(error)
            else:
                self._wrote(batch)
                return
            finally:
                self._write_start = None
            if self._end.is_set():
                deadline = min(deadline, loop.time() + LAST_ATTEMPTS)
            if self._abandoned.is_set() or loop.time() >= deadline:
                self.status.dropped += len(batch)
                self._drop_waiting()
                return
            interrupt = self._abandoned if self._end.is_set() else self._end
            with suppress(TimeoutError):
                async with asyncio.timeout(retry.delay()):
                    await interrupt.wait()

    def _wrote(self, batch: Batch) -> None:
        """Count a written batch; log if the sink works again."""
        if self.status.error:
            dropped = self.status.dropped - self._dropped_before
            lost = f"; {dropped} rows were dropped" if dropped else ""
            log.info("%s works again%s", self.name, lost)
            self.status.error = ""
        self.status.rows += batch.time.size

    def _drop(self, batch: Batch) -> None:
        """Count the rows of a dropped batch; log it once per failure."""
        if self.status.error and not self._abandoned.is_set() and self.status.dropped == self._dropped_before:
            log.warning("%s drops rows until it works again", self.name)
        self.status.dropped += len(batch)

    def _drop_waiting(self) -> None:
        """Drop all queued batches."""
        self.status.dropped += sum(map(len, self._waiting))
        self._waiting.clear()
        self.status.queued = 0

    def _is_failing(self) -> bool:
        """Return True while the sink fails; a write that takes too long counts as failed until it ends."""
        now, start = asyncio.get_running_loop().time(), self._write_start
        if not self.status.error and start is not None and now - start >= STUCK:
            self._failed(EndpointError(self.sink.destination, f"has not completed a write for {STUCK:.0f} s"))
        return bool(self.status.error)

    def _failed(self, error: Exception) -> None:
        if isinstance(error, (OutputClosedError, *MISTAKES)):
            self._abandoned.set()
            self._on_closed()
        if isinstance(error, OutputClosedError):
            return
        reason = reason_of(error)
        if isinstance(error, MISTAKES):
            self.mistake, reason = error, reason + location(self.sink, error)
        if not (self.status.error or self.mistake):  # the run raises a mistake
            log.warning("%s failed: %s", self.name, reason)
            self._dropped_before = self.status.dropped
        self.status.error = reason
        self.status.failures += 1
        self._room.set()
