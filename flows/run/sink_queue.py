"""What stands before a sink in a live run: a bounded queue, the task that empties it, and its retries."""

import asyncio
from collections import deque
from contextlib import suppress
from math import inf
from typing import Any, Final

from flows.run import log_events
from flows.run.back_off import FIRST_RETRY, LAST_RETRY
from operators.batch import Batch
from operators.errors import EndpointError
from operators.ports import Sink, SinkStatus

FAREWELL: Final = 5.0  # s, how long a failing sink is retried once the run is over
STUCK: Final = 10.0  # s, that one write may take while others wait; then the sink counts as failing


class SinkQueue:
    """A sink's queue and the task that empties it.

    A write that fails is tried again with the same batch. While it fails, or takes too long, nobody waits:
    what finds no room is dropped and counted. A sink that may lose rows makes nobody wait, ever: its oldest
    batch is dropped.
    """

    def __init__(self, name: str, sink: Sink[Any]) -> None:
        """Stand before `sink`, which the run knows by `name`."""
        self.name, self.sink = name, sink
        self.status = SinkStatus(records=sink.records)
        self._waiting: deque[Batch] = deque()
        self._more, self._room = asyncio.Event(), asyncio.Event()
        self._end, self._given_up = asyncio.Event(), asyncio.Event()
        self._writing: float | None = None  # s of the loop, since when
        self._dropped_before = 0  # rows, when it last worked

    def offer(self, batch: Batch) -> bool:
        """Queue a batch if there is room, or if this sink's policy makes some."""
        if len(self._waiting) >= self.sink.capacity:
            if not self.sink.lossless:
                self._lose(self._waiting.popleft())
            elif self.status.error or self._is_stuck():  # waiting for it would stop the others
                self._lose(batch)
                return True
            else:
                return False
        self._waiting.append(batch)
        self.status.queued = len(self._waiting)
        self._more.set()
        return True

    async def put(self, batch: Batch) -> None:
        """Queue a batch, waiting for room."""
        while not self.offer(batch):
            self._room.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(STUCK):
                    await self._room.wait()

    def complete(self) -> None:
        """No more will come."""
        self._end.set()
        self._more.set()

    def give_up(self) -> None:
        """Retry no more."""
        self._given_up.set()

    async def carry(self) -> None:
        """Write what is queued until all is written, then close."""
        try:
            while self._waiting or not self._end.is_set():
                if not self._waiting:
                    self._more.clear()
                    await self._more.wait()
                    continue
                batch = self._waiting.popleft()
                self.status.queued = len(self._waiting)
                self._room.set()
                await self._write(batch)
            await self.sink.close()
        except asyncio.CancelledError:
            self._drop_waiting()
            self._failed(EndpointError(self.sink.destination, "was given up while it was being written"))
            raise
        except Exception as error:  # noqa: BLE001 - the others must be closed too
            self._failed(error)

    async def _write(self, batch: Batch) -> None:
        """Write a batch, again and again until it is written or given up."""
        loop, retry, deadline = asyncio.get_running_loop(), FIRST_RETRY, inf
        while True:
            self._writing = loop.time()
            try:
                await self.sink.write(batch)
            except asyncio.CancelledError:
                self.status.dropped += len(batch)
                raise
            except Exception as error:  # noqa: BLE001 - whatever a sink raises must not stop the others
                self._failed(error)
            else:
                self._wrote(batch)
                return
            finally:
                self._writing = None
            if self._end.is_set():
                deadline = min(deadline, loop.time() + FAREWELL)
            if self._given_up.is_set() or loop.time() >= deadline:
                self.status.dropped += len(batch)
                self._drop_waiting()
                return
            interrupt = self._given_up if self._end.is_set() else self._end
            with suppress(TimeoutError):
                async with asyncio.timeout(retry):
                    await interrupt.wait()
            retry = min(2 * retry, LAST_RETRY)

    def _wrote(self, batch: Batch) -> None:
        """Count a batch that was written; say it if the sink works again."""
        if self.status.error:
            log_events.sink_restored(self.name, self.status.dropped - self._dropped_before)
            self.status.error = ""
        self.status.rows += len(batch)

    def _lose(self, batch: Batch) -> None:
        """Count a batch for which there is no room; say it once in each failure."""
        if self.status.error and self.status.dropped == self._dropped_before:
            log_events.sink_drops(self.name)
        self.status.dropped += len(batch)

    def _drop_waiting(self) -> None:
        """Empty the queue unwritten."""
        self.status.dropped += sum(map(len, self._waiting))
        self._waiting.clear()
        self.status.queued = 0

    def _is_stuck(self) -> bool:
        """Whether the write at hand takes too long; it counts as failed until it ends."""
        stuck = self._writing is not None and asyncio.get_running_loop().time() - self._writing >= STUCK
        if stuck:
            self._failed(EndpointError(self.sink.destination, f"has been stuck for {STUCK:.0f} s"))
        return stuck

    def _failed(self, error: Exception) -> None:
        reason = log_events.reason_of(error)
        if not self.status.error:
            log_events.sink_failed(self.name, reason)
            self._dropped_before = self.status.dropped
        self.status.error = reason
        self.status.failures += 1
        self._room.set()
