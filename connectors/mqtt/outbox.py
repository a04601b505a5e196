"""Outbox of a rig: numbers slip events and stores them before they are sent."""

import asyncio
import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import inf
from pathlib import Path
from secrets import token_hex

from msgspec.structs import replace

from connectors.events import Event
from connectors.mqtt.outbox_log import Entry, OutboxLog
from operators.errors import EndpointError, os_error_reason
from operators.ports import BackOff
from storage.background_task import BackgroundTask

log = logging.getLogger("slipflow")

WRITE_TIMEOUT = 1.0  # s; then events are sent from memory
MEMORY_MAX = 10_000  # events in memory
ACKNOWLEDGE_EVERY = 0.2  # s between writes of acknowledgements
LAST_ATTEMPTS = 5.0  # s; a failing disk is retried for this time on close
EPOCHS_ANNOUNCED = 100  # newest epochs in the head document


class Outbox:
    """Numbered events of one rig on disk, kept between runs and used by one process at a time.

    Each run begins an epoch, a series of numbers from 1, so that no number is used twice whatever a crash or
    power cut has lost. The numbers of the epoch of this run in order::

        1 .. durable .. written .. newest       stored: written to the log, then fsynced in another thread
        1 .. sent ..... released .. newest      sent: the broker has acknowledged them, in order

    An event is released when it is written, so that it survives a crash of the process. Waiting for the fsync
    would not protect it from a power cut. While the disk fails, and 1 s after it has ceased to respond, all
    events are released and sent from memory, and written later; those not written when the process ends are
    lost. Memory has the events that are not durable, or not sent. If it is full while the disk fails, the
    oldest sent ones are not kept: they cannot be requested again.

    Attributes:
        path: The folder.
        epoch: Name of the epoch of this run.
        error: Reason why the disk cannot be written; empty if it can.
        not_kept: Number of events that were sent, but not written.
        on_pending: Called when there is an event to send.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to use the folder `path`."""
        self.path, self.epoch, self.error, self.not_kept = path, token_hex(6), "", 0
        self.on_pending: Callable[[], object] = lambda: None
        self._log = OutboxLog(path, self.epoch)
        self._memory: dict[int, Entry] = {}  # by number
        self._newest = self._written = self._durable = 0  # numbers
        self._rewrite = False  # a write or fsync has failed: what is not durable is written again
        self._released: dict[str, int] = {}  # number by epoch, oldest epoch first
        self._sent: dict[str, int] = {}  # the same
        self._sent_unwritten: dict[str, int] = {}  # the same, of which the log does not know yet
        self._closing_until = inf  # loop time, s
        self._write_due, self._sync_due, self._progress = asyncio.Event(), asyncio.Event(), asyncio.Event()

    @property
    def waiting(self) -> int:
        """Number of unsent events."""
        return sum(max(0, last - self._sent[epoch]) for epoch, last in self._released.items())

    @property
    def unstored(self) -> int:
        """Number of events that are neither written nor acknowledged by the broker."""
        return self._newest - max(self._written, self._sent.get(self.epoch, 0))

    def heads(self) -> list[tuple[str, int]]:
        """Return the newest epochs, that of this run last, each with the newest number that was sent."""
        kept = {*self._log.epochs, self.epoch}
        return [(epoch, sent) for epoch, sent in self._sent.items() if epoch in kept][-EPOCHS_ANNOUNCED:]

    async def open(self) -> None:
        """Open the folder.

        Raises:
            EndpointError: if another run uses the folder, or it cannot be read or written.
            InputError: if the path is not an outbox.
        """
        try:
            self._sent = await asyncio.to_thread(self._log.open)
        except BaseException as error:
            self._log.close()
            if isinstance(error, OSError):
                reason = f"cannot be used: {os_error_reason(error)}"
                raise EndpointError(str(self.path), reason) from error
            raise
        self._released = {epoch: self._log.span(epoch)[1] for epoch in self._sent}
        self._released[self.epoch] = self._sent[self.epoch] = 0
        where = str(self.path)
        self._writing = BackgroundTask(where, "the writing of events", self._keep_writing(), self._fail)
        self._syncing = BackgroundTask(where, "the fsync of events", self._keep_syncing())

    async def append(self, drafts: Sequence[Event]) -> None:
        """Store events under new numbers, or raise EndpointError: the disk fails and memory is full.

        The epoch and number of the drafts are ignored.
        """
        self._make_room(len(drafts))
        for draft in drafts:
            self._newest += 1
            payload = replace(draft, epoch=self.epoch, seq=self._newest).encode()
            self._memory[self._newest] = Entry(self.epoch, self._newest, draft.finger, payload)
        newest = self._newest
        self._write_due.set()
        try:
            async with asyncio.timeout(WRITE_TIMEOUT):
                while self._released[self.epoch] < newest and not self.error:
                    await self._progress.wait()
        except TimeoutError:
            self._fail("the disk does not respond")
        self._release(newest)

    async def next(self, limit: int) -> list[Entry]:
        """Return the oldest unsent entries, at most `limit`, all of one epoch."""
        for epoch, last in list(self._released.items()):
            while self._sent[epoch] < last:
                try:
                    found, reached = await self.between(epoch, self._sent[epoch] + 1, last, limit)
                except OSError as error:
                    log.warning("%s: cannot be read, retrying: %s", self.path, os_error_reason(error))
                    break  # epochs do not wait for each other
                if found:
                    return found
                self._skip_to(epoch, reached + 1)
        return []

    async def between(self, epoch: str, first: int, last: int, limit: int) -> tuple[list[Entry], int]:
        """Return at most `limit` entries `first` to `last` of an epoch, and the last number covered."""
        oldest, newest = self._log.span(epoch)
        if epoch == self.epoch:
            newest = self._released[epoch]
            last = min(last, newest)
        numbers = range(max(first, oldest), min(last, newest) + 1)[:limit]
        memory = self._memory if epoch == self.epoch else {}
        found = {number: memory[number] for number in numbers if number in memory}
        if others := [number for number in numbers if number not in found]:
            stored = await asyncio.to_thread(self._log.read, epoch, others)
            found |= {entry.seq: entry for entry in stored}
        reached = numbers[-1] if len(numbers) == limit else last
        return [found[number] for number in numbers if number in found], reached

    def acknowledge(self, entries: Sequence[Entry]) -> None:
        """Mark the oldest unsent entries as received by the broker."""
        for entry in entries:
            self._skip_to(entry.epoch, entry.seq)
            self._sent[entry.epoch] = self._sent_unwritten[entry.epoch] = entry.seq
        self._forget()
        asyncio.get_running_loop().call_later(ACKNOWLEDGE_EVERY, self._write_due.set)

    async def close(self) -> None:
        """Store everything and close the files; wait as long as a slow disk takes, but 5 s for a failing one.

        Events that are then still `unstored` are lost, also if the call is cancelled.
        """
        self._closing_until = asyncio.get_running_loop().time() + LAST_ATTEMPTS
        self._write_due.set()
        try:
            await self._writing.end(None)
        finally:
            await self._syncing.end()
            if self.unstored:
                log.error("%s: %s; %d events are lost", self.path, self.error or "not written", self.unstored)
            stored = self._log.span(self.epoch)[1]
            self.not_kept += sum(stored < each <= self._sent[self.epoch] for each in self._memory)
            if self.not_kept:
                text = "%s: %d events that the broker has received are not kept"
                log.error(text, self.path, self.not_kept)
        with suppress(OSError):
            await asyncio.to_thread(self._log.sync)
        await asyncio.to_thread(self._log.close)
        self._writing.check()
        self._syncing.check()

    def _skip_to(self, epoch: str, number: int) -> None:
        """Count the unsent events before a number as sent, because they cannot be read."""
        for seq in range(self._sent[epoch] + 1, number):
            log.error("%s: event %d of epoch %s is damaged and lost", self.path, seq, epoch)
        self._sent[epoch] = self._sent_unwritten[epoch] = number - 1

    def _release(self, number: int) -> None:
        """Let the events up to a number be sent."""
        if number > self._released[self.epoch]:
            self._released[self.epoch] = number
            self.on_pending()
        self._progress.set()  # wakes the calls that wait now
        self._progress.clear()

    def _make_room(self, count: int) -> None:
        """Forget the oldest events that need no memory: written, or acknowledged by the broker."""
        while len(self._memory) + count > MEMORY_MAX:
            oldest = next(iter(self._memory), inf)
            if oldest > max(self._written, self._sent[self.epoch]):
                reason = f"{self.error}, and memory is full with {self.waiting} unsent events"
                raise EndpointError(str(self.path), reason)
            del self._memory[int(oldest)]
            self.not_kept += oldest > self._log.span(self.epoch)[1]

    def _forget(self) -> None:
        """Forget the events that are durable and sent."""
        last = min(self._durable, self._sent[self.epoch])
        while self._memory and (oldest := next(iter(self._memory))) <= last:
            del self._memory[oldest]

    def _fail(self, reason: str) -> None:
        """Send from memory until the disk can be written again."""
        if not self.error:
            self.error = reason
            log.error("%s: %s; events are kept in memory until it can be written", self.path, reason)
        self._release(self._newest)

    async def _keep_writing(self) -> None:
        retry, loop = BackOff(), asyncio.get_running_loop()
        while (
            self._closing_until == inf
            or self._newest > self._written
            or self._rewrite
            or self._sent_unwritten
        ):
            await self._write_due.wait()
            self._write_due.clear()
            if self._rewrite:
                self._written, self._rewrite = self._durable, False
            newest, sent, self._sent_unwritten = self._newest, self._sent_unwritten, {}
            entries = [entry for entry in self._memory.values() if entry.seq > self._written]
            try:
                await asyncio.to_thread(self._store, entries, sent)
            except Exception as error:  # noqa: BLE001 - retried after any error, and reported
                self._rewrite, self._sent_unwritten = True, sent | self._sent_unwritten
                self._fail(_reason(error))
                if loop.time() > self._closing_until:
                    return
                await asyncio.sleep(retry.delay())
                self._write_due.set()
                continue
            retry.reset()
            if self.error:
                self.error = ""
                text = "%s: can be written again; the events kept in memory are in it, %d are not kept"
                log.info(text, self.path, self.not_kept)
            self._written = newest
            self._release(newest)
            self._sync_due.set()

    def _store(self, entries: Sequence[Entry], sent: dict[str, int]) -> None:
        self._log.append(entries, sent)
        with suppress(OSError):  # tried again after the next write
            self._log.prune(self._sent)

    async def _keep_syncing(self) -> None:
        while True:
            await self._sync_due.wait()
            self._sync_due.clear()
            written = self._written
            try:
                await asyncio.to_thread(self._log.sync)
            except Exception as error:  # noqa: BLE001 - retried after any error, and reported
                self._rewrite = True
                self._fail(_reason(error))
                self._write_due.set()
                continue
            self._durable = written
            self._forget()


def _reason(error: Exception) -> str:
    return f"cannot be written: {os_error_reason(error) if isinstance(error, OSError) else repr(error)}"
