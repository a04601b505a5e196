"""Outbox of a rig: numbers slip events and stores them before they are sent."""

import asyncio
import errno
import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from secrets import token_hex

from connectors.events import Event
from connectors.mqtt.outbox_log import Entry, Key, OutboxLog
from operators.errors import EndpointError, SlipflowError, os_error_reason
from operators.ports import BackOff
from storage.background_task import BackgroundTask

log = logging.getLogger("slipflow")

WRITE_TIMEOUT = 1.0  # s; then events are sent from memory
MEMORY_MAX = 10_000  # events in memory while the disk cannot be written
ACKNOWLEDGE_EVERY = 0.2  # s between writes of acknowledgements
LAST_ATTEMPTS = 5.0  # s; a failing disk is retried for this time on close
EPOCHS_ANNOUNCED = 100  # newest epochs in the head document


class Outbox:
    """Numbered events of one rig on disk, kept between runs and used by one process at a time.

    Two independent states of an event::

        append --> unwritten --write--> written --fsync--> durable
                       ^                   |
                       +--- fsync fails ---+

        append --> held --written, or no write within 1 s--> unsent --broker acknowledges--> sent

    Events are in memory until they are durable. They are sent after they are written, so that they survive
    a crash of the process; fsync follows in another thread. Waiting for it would not protect them from a
    power cut. While the disk fails, events are sent from memory and written later; if the process is killed
    before, those not yet sent are lost.

    Each run begins an epoch, a series of numbers from 1, so that no number is used twice whatever a crash or
    power cut has lost.

    Attributes:
        path: The folder.
        epoch: Name of the epoch of this run.
        error: Reason why the disk cannot be written; empty if it can.
        on_pending: Called when there is an event to send.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to use the folder `path`."""
        self.path, self.epoch, self.error = path, token_hex(6), ""
        self.on_pending: Callable[[], object] = lambda: None
        self._log = OutboxLog(path, self.epoch)
        self._undurable: dict[int, Entry] = {}  # events of this run, by number
        self._written = 0  # newest number that is written; a failed fsync reduces it
        self._unsent: dict[Key, str] = {}  # fingertips of events that may be sent, in order
        self._heads: dict[str, int] = {}  # newest number that was sent, by epoch
        self._acknowledged: list[Key] = []  # acknowledgements that are not written yet
        self._newest = self._released = 0  # newest number; newest one that may be sent
        self._write_due, self._sync_due, self._progress = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self._storing = self._failing = False  # a write is in progress; the latest one failed
        self._tasks: list[BackgroundTask] = []

    @property
    def waiting(self) -> int:
        """Number of unsent events."""
        return len(self._unsent)

    @property
    def unstored(self) -> int:
        """Number of events that are neither written nor acknowledged by the broker."""
        return sum(not self._is_sent(entry) for entry in self._unwritten())

    def heads(self) -> list[tuple[str, int]]:
        """Return the newest epochs, that of this run last, each with the newest number that was sent."""
        kept = {*self._log.epochs, self.epoch}
        return [(name, last) for name, last in self._heads.items() if name in kept][-EPOCHS_ANNOUNCED:]

    async def open(self) -> None:
        """Open the folder, or start in memory if the disk is full.

        Raises:
            EndpointError: if another run uses the folder, or it cannot be read or written.
            InputError: if the path is not an outbox.
        """
        try:
            self._unsent = await asyncio.to_thread(self._log.open)
            await asyncio.to_thread(self._log.append, (), ())  # shows that it can be written
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                self._log.close()
                raise EndpointError(str(self.path), f"cannot be used: {os_error_reason(error)}") from error
            self._fail(_reason(error))
            self._write_due.set()
        except BaseException:
            self._log.close()
            raise
        for epoch in self._log.epochs:
            _, last = self._log.span(epoch)
            while (epoch, last) in self._unsent:
                last -= 1
            self._heads[epoch] = last
        self._heads[self.epoch] = 0
        where = str(self.path)
        self._tasks = [
            BackgroundTask(where, "the writing of events", self._keep_writing(), self._stop_writing),
            BackgroundTask(where, "the fsync of events", self._keep_syncing()),
        ]

    async def append(self, drafts: Sequence[Event]) -> None:
        """Store events under new numbers; the epoch and number of the drafts are ignored.

        Raises:
            EndpointError: if the disk cannot be written and memory is full; then no event is stored.
        """
        self._make_room(len(drafts))
        for draft in drafts:
            self._newest += 1
            payload = replace(draft, epoch=self.epoch, seq=self._newest).encode()
            self._undurable[self._newest] = Entry(self.epoch, self._newest, draft.finger, payload)
        newest = self._newest
        self._write_due.set()
        try:
            async with asyncio.timeout(WRITE_TIMEOUT):
                while self._released < newest and not self.error:
                    await self._progress.wait()
        except TimeoutError:
            self._fail("the disk does not respond")
        self._release(newest)

    async def next(self, limit: int, allowed: Callable[[str], bool] = lambda _: True) -> list[Entry]:
        """Return the oldest unsent entries of the fingertips that are `allowed`."""

        def unsent() -> list[Key]:
            return list(islice((key for key, finger in self._unsent.items() if allowed(finger)), limit))

        while keys := unsent():
            try:
                found = await self._load(keys)
            except OSError as error:
                log.warning("%s: cannot be read, retrying: %s", self.path, os_error_reason(error))
                in_memory = self._undurable.values()
                ready = (each for each in in_memory if each.key in self._unsent and allowed(each.finger))
                return list(islice(ready, limit))
            for epoch, seq in set(keys) - {entry.key for entry in found}:
                del self._unsent[epoch, seq]
                log.error("%s: event %d of epoch %s is damaged and lost", self.path, seq, epoch)
            if found:
                return found
        return []

    async def between(self, epoch: str, first: int, last: int, limit: int) -> tuple[list[Entry], int]:
        """Return at most `limit` entries `first` to `last` of an epoch, and the last number covered.

        Raises:
            OSError: if the disk cannot be read.
        """
        oldest, newest = self._log.span(epoch)
        if epoch == self.epoch:
            newest = self._released
            last = min(last, newest)
        numbers = range(max(first, oldest), min(last, newest) + 1)[:limit]
        found = await self._load([(epoch, number) for number in numbers])
        return found, numbers[-1] if len(numbers) == limit else last

    def acknowledge(self, entries: Sequence[Entry]) -> None:
        """Mark entries as received by the broker."""
        for entry in entries:
            self._unsent.pop(entry.key, None)
            self._heads[entry.epoch] = max(self._heads[entry.epoch], entry.seq)
            self._acknowledged.append(entry.key)
        del self._acknowledged[:-MEMORY_MAX]  # the events without one are sent again by the next run
        asyncio.get_running_loop().call_later(ACKNOWLEDGE_EVERY, self._write_due.set)

    async def close(self) -> None:
        """Store everything and close the files; wait as long as a slow disk takes, but 5 s for a failing one.

        Events that are then still `unstored` are lost, also if the call is cancelled.

        Raises:
            EndpointError: if a background task of the outbox has failed; the files are closed.
        """
        loop = asyncio.get_running_loop()
        deadline = loop.time() + LAST_ATTEMPTS
        self._write_due.set()
        try:
            while self._storing or self._unwritten() or self._acknowledged:
                if self._failing and (loop.time() > deadline or self._tasks[0].done):
                    break
                await self._progress.wait()
        finally:
            await self._end_tasks()
        if not self._failing:
            with suppress(OSError):
                await asyncio.to_thread(self._log.sync)
        await asyncio.to_thread(self._log.close)
        for task in self._tasks:
            task.check()

    async def _end_tasks(self) -> None:
        self._tasks[0].ending = True  # no further write begins
        try:
            while self._storing:  # a write in progress cannot be stopped, and its events are stored
                await self._progress.wait()
        finally:
            for task in self._tasks:
                await task.end()
            if self.unstored:
                log.error("%s: %s; %d events are lost", self.path, self.error or "not written", self.unstored)

    async def _load(self, keys: Sequence[Key]) -> list[Entry]:
        """Return the entries that are in memory, or stored and intact.

        Raises:
            OSError: if the disk cannot be read.
        """
        found = {key: self._undurable[key[1]] for key in keys if self._in_memory(key)}
        if len(found) < len(keys):
            stored = await asyncio.to_thread(self._log.read, [key for key in keys if key not in found])
            found |= {entry.key: entry for entry in stored}
        return [found[key] for key in keys if key in found]

    def _in_memory(self, key: Key) -> bool:
        return key[0] == self.epoch and key[1] in self._undurable

    def _unwritten(self) -> list[Entry]:
        return [entry for entry in self._undurable.values() if entry.seq > self._written]

    def _is_sent(self, entry: Entry) -> bool:
        return entry.seq <= self._released and entry.key not in self._unsent

    def _release(self, number: int) -> None:
        """Let the events up to a number be sent."""
        if number <= self._released:
            return
        for seq in range(self._released + 1, number + 1):
            self._unsent[self.epoch, seq] = self._undurable[seq].finger
        self._released = number
        self.on_pending()

    def _make_room(self, count: int) -> None:
        """Forget the oldest events that need no memory: written, or acknowledged by the broker."""
        while len(self._undurable) + count > MEMORY_MAX:
            oldest = next(iter(self._undurable.values()), None)
            if oldest is None or not (oldest.seq <= self._written or self._is_sent(oldest)):
                reason = f"{self.error}, and memory is full with {self.waiting} unsent events"
                raise EndpointError(str(self.path), reason)
            del self._undurable[oldest.seq]

    def _fail(self, reason: str) -> None:
        """Send from memory until the disk can be written again."""
        if not self.error:
            self.error = reason
            log.error("%s: %s; events are kept in memory until it can be written", self.path, reason)
        self._release(self._newest)
        self._announce_progress()

    def _stop_writing(self, reason: str) -> None:
        """Send from memory until the end, because the task that writes has failed."""
        self._storing, self._failing, self.error = False, True, reason
        self._release(self._newest)
        self._announce_progress()

    def _announce_progress(self) -> None:
        self._progress.set()  # wakes the tasks that wait now
        self._progress.clear()

    def _write_again(self) -> None:
        """Treat the events that are not durable as unwritten, so that the next write has all of them."""
        self._written = min(self._undurable, default=self._newest + 1) - 1

    async def _keep_writing(self) -> None:
        retry = BackOff()
        while not self._tasks[0].ending:
            await self._write_due.wait()
            self._write_due.clear()
            if self._log.suspect:
                self._write_again()
            entries, acknowledged, self._storing = self._unwritten(), [*self._acknowledged], True
            before = self._written
            try:
                await asyncio.to_thread(self._store, entries, acknowledged, next(iter(self._unsent), None))
                if self._log.suspect:
                    raise OSError(errno.EIO, "an fsync failed")  # noqa: TRY301 - as one that failed here
            except Exception as error:  # noqa: BLE001 - retried after any error, and reported
                self._storing, self._failing = False, True
                self._fail(_reason(error))
                await asyncio.sleep(retry.delay())
                self._write_due.set()
                continue
            self._storing = self._failing = False
            retry.reset()
            if self.error:
                self.error = ""
                log.warning("%s: can be written again; the events kept in memory are in it", self.path)
            del self._acknowledged[: len(acknowledged)]
            if entries:
                self._release(entries[-1].seq)
                if self._written == before:  # else an fsync has failed meanwhile: they are written again
                    self._written = entries[-1].seq
                self._sync_due.set()
            self._announce_progress()

    def _store(self, entries: Sequence[Entry], acknowledged: Sequence[Key], oldest: Key | None) -> None:
        self._log.append(entries, acknowledged)
        with suppress(OSError):  # tried again after the next write
            self._log.prune(oldest)

    async def _keep_syncing(self) -> None:
        while True:
            await self._sync_due.wait()
            self._sync_due.clear()
            written = self._written
            try:
                await asyncio.to_thread(self._log.sync)
            except Exception as error:  # noqa: BLE001 - retried after any error, and reported
                self._write_again()
                self._fail(_reason(error))
                self._write_due.set()
                continue
            for number in [number for number in self._undurable if number <= written]:
                del self._undurable[number]


def _reason(error: Exception) -> str:
    if isinstance(error, OSError):
        return f"cannot be written: {os_error_reason(error)}"
    return str(error) if isinstance(error, SlipflowError) else f"cannot be written: {error!r}"
