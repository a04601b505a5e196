"""Outbox of a rig: numbers slip events and stores them before they are sent."""

import asyncio
import errno
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from secrets import token_hex

from connectors.events import Event
from connectors.mqtt.outbox_log import Entry, Epoch, OutboxLog
from connectors.mqtt.range_set import RangeSet
from operators.back_off import BackOff
from operators.errors import EndpointError, SlipflowError, os_error_reason
from storage.background_task import BackgroundTask

log = logging.getLogger("slipflow")

WRITE_TIMEOUT = 1.0  # s; then events are sent from memory
CACHED = 256  # newest events, kept in memory to save reading them back
MEMORY_MAX = 10_000  # events in memory while the disk cannot be written
ACKNOWLEDGE_EVERY = 0.2  # s between writes of acknowledgements
READ_AGAIN = 5.0  # s, after the disk could not be read
LAST_ATTEMPTS = 5.0  # s; a failing disk is retried for this time on close
EPOCHS_ANNOUNCED = 100  # newest epochs in the head document


class Outbox:
    """Numbered events of one rig on disk, kept between runs and used by one process at a time.

    Events are sent after they are written, so that they survive a crash of the process; fsync follows in
    another thread. Waiting for it would not protect them from a power cut. If the disk fails, or does not
    respond within 1 s, events are sent from memory and written later; if the process is killed before, those
    not yet sent are lost.

    An epoch is a series of numbers that continues from run to run. A new one begins unless the run before
    ended in order, so that no number is used twice whatever a crash or power cut has lost.

    Attributes:
        path: The folder.
        error: Reason why the disk cannot be written; empty if it can.
        on_pending: Called when there is an event to send.
    """

    def __init__(self, path: Path, *, keep: int, keep_for: float) -> None:
        """Prepare to use the folder `path`, which keeps `keep` sent events for `keep_for` s."""
        self.path, self.error = path, ""
        self.on_pending: Callable[[], object] = lambda: None
        self._log = OutboxLog(path, keep=keep, keep_for=keep_for)
        self._epoch = Epoch("", 0)
        self._memory: dict[int, Entry] = {}  # the newest events by id
        self._last = self._written = self._durable = 0  # newest ids: used, written, durable
        self._released = 0  # newest id that may be sent
        self._read = 0  # newest id returned by `next`
        self._settled = RangeSet()  # ids that need not be sent: acknowledged, or not readable
        self._unsaved = RangeSet()  # acknowledged ids that are not stored yet
        self._write_due, self._sync_due, self._progress = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self._storing = self._failing = False  # a write is in progress; the latest one failed
        self._tasks: list[BackgroundTask] = []

    @property
    def epoch(self) -> str:
        """Name of the current epoch."""
        return self._epoch.name

    @property
    def waiting(self) -> int:
        """Number of unsent events."""
        return sum(last - first + 1 for first, last in self._settled.gaps(1, self._released))

    @property
    def unstored(self) -> int:
        """Number of events that are neither written nor acknowledged by the broker."""
        return sum(last - first + 1 for first, last in self._settled.gaps(self._written + 1, self._last))

    def heads(self) -> list[tuple[str, int]]:
        """Return the newest epochs, the current one last, each with its newest number that is settled."""
        newest = [(each, self._settled.below(each.base + each.last)) for each in self._log.epochs]
        return [(each.name, max(0, last - each.base)) for each, last in newest[-EPOCHS_ANNOUNCED:]]

    async def open(self) -> None:
        """Open the folder, or start in memory if the disk is full.

        Raises:
            EndpointError: if another run uses the folder, or it cannot be read or written.
            InputError: if the path is not an outbox.
        """
        try:
            await self._begin()
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                self._log.close()
                raise EndpointError(str(self.path), f"cannot be used: {os_error_reason(error)}") from error
            if self._log.complete or not self.epoch:
                self._begin_epoch()  # an epoch that is not marked as in use may not continue
            self._fail(_reason(error))
        except BaseException:
            self._log.close()
            raise
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
        if not drafts:
            return
        self._make_room(len(drafts))
        now = time.time()
        for draft in drafts:
            self._last = number = self._last + 1
            seq = number - self._epoch.base
            payload = replace(draft, epoch=self.epoch, seq=seq).encode()
            self._memory[number] = Entry(number, self.epoch, seq, draft.finger, payload, now)
        newest = self._last
        self._write_due.set()
        try:
            async with asyncio.timeout(WRITE_TIMEOUT):
                while self._written < newest and not self.error:
                    await self._progress.wait()
        except TimeoutError:
            self._fail("the disk does not respond")
        self._release(newest)

    async def next(self, limit: int) -> list[Entry]:
        """Return the next unsent entries, each once unless `rewind` is called; [] if there are none."""
        while ids := list(islice(self._pending(self._read + 1), limit)):
            self._read = ids[-1]
            try:
                found = await self._load(ids)
            except OSError as error:
                log.warning("%s: cannot be read, retrying: %s", self.path, os_error_reason(error))
                asyncio.get_running_loop().call_later(READ_AGAIN, self._resume)
                found = [self._memory[number] for number in ids if number in self._memory]
            else:
                for number in set(ids) - {entry.id for entry in found}:
                    self._settled.add(number)
                    epoch = next(each for each in reversed(self._log.epochs) if each.base < number)
                    text = "%s: event %d of epoch %s is damaged and lost"
                    log.error(text, self.path, number - epoch.base, epoch.name)
            if found:
                return found
        return []

    def rewind(self) -> None:
        """Restart `next` at the first unacknowledged entry."""
        self._read = 0

    async def between(self, epoch: str, first: int, last: int, limit: int) -> tuple[list[Entry], int]:
        """Return at most `limit` entries `first` to `last` of an epoch, and the last number covered.

        Raises:
            EndpointError: if the disk cannot be read.
        """
        known = next((each for each in self._log.epochs if each.name == epoch), None)
        if known is None:
            return [], last
        if known is self._epoch:
            last = min(last, self._released - known.base)
        oldest = self._log.first or next(iter(self._memory), 0)
        ids = range(max(known.base + first, oldest), known.base + min(last, known.last) + 1)[:limit]
        try:
            found = await self._load(ids)
        except OSError as error:
            raise EndpointError(str(self.path), f"cannot be read: {os_error_reason(error)}") from error
        return found, ids[-1] - known.base if len(ids) == limit else last

    def acknowledge(self, entries: Sequence[Entry]) -> None:
        """Mark entries as received by the broker."""
        for entry in entries:
            self._settled.add(entry.id)
            self._unsaved.add(entry.id)
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
            while self._storing or self._written < self._last or len(self._unsaved):
                if self._failing and (loop.time() > deadline or self._tasks[0].done):
                    break
                await self._progress.wait()
        finally:
            await self._end_tasks()
        if not self._failing:
            with suppress(OSError, SlipflowError):  # the next run begins a new epoch
                await asyncio.to_thread(self._end)
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

    async def _begin(self) -> None:
        """Open the folder, and mark the epoch as in use before its first number is used."""
        await asyncio.to_thread(self._log.open)
        self._settled = self._log.settled
        self._last = self._written = self._durable = self._released = self._log.last
        if self._log.complete:
            self._epoch = self._log.epochs[-1]
        else:
            self._begin_epoch()
        await asyncio.to_thread(self._log.append, self._epoch, (), RangeSet())
        await asyncio.to_thread(self._log.sync)

    def _begin_epoch(self) -> None:
        self._epoch = Epoch(token_hex(6), self._last)
        self._log.epochs.append(self._epoch)

    def _end(self) -> None:
        self._log.append(self._epoch, (), RangeSet(), ended=True)
        self._log.sync()

    def _pending(self, first: int) -> Iterator[int]:
        """Yield the ids from `first` that are to be sent."""
        for low, high in self._settled.gaps(first, self._released):
            yield from range(low, high + 1)

    async def _load(self, ids: Sequence[int]) -> list[Entry]:
        """Return the entries that are in memory, or stored and intact.

        Raises:
            OSError: if the disk cannot be read.
        """
        found = {number: self._memory[number] for number in ids if number in self._memory}
        if len(found) < len(ids):
            stored = await asyncio.to_thread(
                self._log.read, [number for number in ids if number not in found]
            )
            found |= {entry.id: entry for entry in stored}
        return [found[number] for number in ids if number in found]

    def _release(self, number: int) -> None:
        """Let the events up to an id be sent."""
        if number > self._released:
            self._released, self._epoch.last = number, number - self._epoch.base
            self.on_pending()

    def _resume(self) -> None:
        self.rewind()
        self.on_pending()

    def _make_room(self, count: int) -> None:
        while len(self._memory) + count > MEMORY_MAX:
            oldest = next(iter(self._memory), 0)
            if oldest == 0 or (oldest > self._written and oldest not in self._settled):
                reason = f"{self.error}, and memory is full with {self.waiting} unsent events"
                raise EndpointError(str(self.path), reason)
            del self._memory[oldest]

    def _fail(self, reason: str) -> None:
        """Send from memory until the disk can be written again."""
        if not self.error:
            self.error = reason
            log.error("%s: %s; events are kept in memory until it can be written", self.path, reason)
        self._release(self._last)
        self._announce_progress()

    def _stop_writing(self, reason: str) -> None:
        """Send from memory until the end, because the task that writes has failed."""
        self._storing, self._failing, self.error = False, True, reason
        self._release(self._last)
        self._announce_progress()

    def _announce_progress(self) -> None:
        self._progress.set()  # wakes the tasks that wait now
        self._progress.clear()

    async def _keep_writing(self) -> None:
        retry = BackOff()
        while not self._tasks[0].ending:
            await self._write_due.wait()
            self._write_due.clear()
            entries = [entry for entry in self._memory.values() if entry.id > self._written]
            unsaved, self._unsaved, self._storing = self._unsaved, RangeSet(), True
            before = self._written
            try:
                await asyncio.to_thread(self._store, entries, unsaved, next(self._pending(1), self._last + 1))
                if self._log.suspect:
                    raise OSError(errno.EIO, "an fsync failed")  # noqa: TRY301 - as one that failed here
            except Exception as error:  # noqa: BLE001 - retried after any error, and reported
                self._unsaved = RangeSet([*unsaved, *self._unsaved])
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
            if self._written < before:  # an fsync failed meanwhile: events before `entries` may be lost
                self._write_due.set()
            elif entries:
                self._written = entries[-1].id
                self._release(self._written)
                self._sync_due.set()
            self._announce_progress()

    def _store(self, entries: Sequence[Entry], acknowledged: RangeSet, pending: int) -> None:
        self._log.append(self._epoch, entries, acknowledged)
        with suppress(OSError):  # tried again after the next write
            self._log.prune(pending)

    async def _keep_syncing(self) -> None:
        while True:
            await self._sync_due.wait()
            self._sync_due.clear()
            written = self._written
            try:
                await asyncio.to_thread(self._log.sync)
            except Exception as error:  # noqa: BLE001 - retried after any error, and reported
                self._written = self._durable  # the events since then are written again
                self._fail(_reason(error))
                self._write_due.set()
                continue
            self._durable = max(self._durable, written)
            for number in list(self._memory)[:-CACHED]:
                if number <= self._durable:
                    del self._memory[number]


def _reason(error: Exception) -> str:
    if isinstance(error, OSError):
        return f"cannot be written: {os_error_reason(error)}"
    return str(error) if isinstance(error, SlipflowError) else f"cannot be written: {error!r}"
