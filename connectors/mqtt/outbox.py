"""Outbox of a rig: numbers slip events and stores them before they are sent."""

import asyncio
import logging
import os
import time
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from secrets import token_hex
from sqlite3 import Error as SqliteError
from typing import ParamSpec, TypeVar

from connectors.events import Event
from connectors.mqtt.outbox_file import Damaged, Entry, Epoch, OutboxFile, is_full, reason_of
from connectors.mqtt.range_set import RangeSet
from operators.back_off import BackOff
from operators.errors import EndpointError, SlipflowError
from storage.lock import lock_file

P = ParamSpec("P")
T = TypeVar("T")

log = logging.getLogger("slipflow")

WRITE_TIMEOUT = 1.0  # s; then events are sent from memory
EVENTS_PER_TIMEOUT = 1000  # the timeout is extended once per this number of events
SYNC_TIMEOUT = 10.0  # s
CACHED = 256  # newest events, kept in memory to save reading them back
MEMORY_MAX = 10_000  # events in memory while the file cannot be written
ACKNOWLEDGE_EVERY = 0.2  # s between writes of acknowledgements
PRUNE_EVERY = 10.0  # s
EPOCHS_ANNOUNCED = 12  # newest epochs in the head document


class Outbox:
    """Numbered events of one rig in a file that is kept between runs and used by one process at a time.

    An epoch is a series of numbers that continues from run to run. Events in the file survive a crash of the
    process. They are sent without waiting for fsync, which runs in another thread: waiting would not protect
    them from a power cut. If the system has rebooted, a power cut may have lost numbers; then a new epoch
    starts, so that no number is used twice.

    While the file cannot be written, events are numbered in memory, for the same reason in a new epoch, and
    written as soon as possible; if the process is killed before, they may be lost.
    """

    def __init__(self, path: Path, *, keep: int, keep_for: float) -> None:
        """Prepare to use `path`, which keeps `keep` sent events for `keep_for` s, and all unsent ones."""
        self.path, self._keep, self._keep_for = path, keep, keep_for
        self.on_pending: Callable[[], object] = lambda: None  # called when there is an event to send
        self.waiting = 0  # unsent events
        self.error = ""  # reason why the file cannot be written; empty if it can
        self._thread = ThreadPoolExecutor(1, "slipflow-outbox")
        self._syncer = ThreadPoolExecutor(1, "slipflow-outbox-sync")
        self._boot = boot_id()
        self._lock: int | None = None
        self._file: OutboxFile | None = None
        self._opened = False  # the file has been opened at least once
        self._epochs: list[Epoch] = []  # oldest first; the last is the current one
        self._memory = deque[Entry]()  # the newest events
        self._durable = self._written = self._last = 0  # newest ids: durable, in the file, used
        self._read = 0  # newest id returned by `next`
        self._doubtful = list[int]()  # ids to delete from the file if they are in it
        self._acknowledged = RangeSet()  # ids
        self._unsaved = RangeSet()  # acknowledged ids not yet marked in the file
        self._maintenance_due, self._unsynced = asyncio.Event(), asyncio.Event()
        self._appending = asyncio.Lock()
        self._tasks = set[asyncio.Task[None]]()

    async def open(self) -> None:
        """Open the file, or start in memory if the disk is full.

        Raises:
            EndpointError: if another run uses the file, or it cannot be written.
            InputError: if the file is not an outbox.
        """
        try:
            self._lock = await self._do(_lock, self.path)
            self._file = await self._do(OutboxFile, self.path)
        except EndpointError as error:
            if not is_full(error.__cause__):
                await self.close()
                raise
            self._last = time.time_ns() // 1000  # beyond all ids in the file
            self._fail(error)
        except BaseException:
            await self.close()
            raise
        else:
            self._epochs, self._written = self._file.epochs, self._file.highest
            self._durable = self._last = self._written
            self.waiting, self._opened = self._file.waiting, True
            await self._continue_epoch(self._file)
        self._start(self._keep_maintained())
        self._start(self._keep_synced())

    @property
    def epoch(self) -> str:
        """Name of the current epoch."""
        return self._epochs[-1].name

    def heads(self) -> list[tuple[str, int]]:
        """Return the newest epochs, the current one last, each with its newest acknowledged number."""
        return [(epoch.name, epoch.sent) for epoch in self._epochs[-EPOCHS_ANNOUNCED:]]

    async def append(self, drafts: Sequence[Event]) -> None:
        """Store events under new numbers; the epoch and number of the drafts are ignored.

        Raises:
            EndpointError: if the file cannot be written and memory is full; then no event is stored.
        """
        if drafts:
            await asyncio.shield(self._start(self._append(drafts)))  # all or none

    async def next(self, limit: int) -> list[Entry]:
        """Return the next unsent entries, each once unless `rewind` is called; [] if there are none."""
        found = list[Entry]()
        if self._file and not self.error and not (self._memory and self._read >= self._memory[0].id - 1):
            try:
                await self._save_acknowledged()
                found = await self._do(self._file.waiting_after, self._read, limit)
            except EndpointError as error:
                self._fail(error)  # continue from memory
        found = [entry for entry in found if entry.id not in self._acknowledged] or [
            entry for entry in self._memory if entry.id > self._read and entry.id not in self._acknowledged
        ]
        found = found[:limit]
        self._read = found[-1].id if found else self._read
        return found

    def rewind(self, before: int = 1) -> None:
        """Restart `next` at the first unacknowledged entry whose id is at least `before`."""
        self._read = min(self._read, before - 1)

    async def between(self, epoch: str, first: int, last: int, limit: int) -> tuple[list[Entry], int]:
        """Return at most `limit` entries `first` to `last` of an epoch, and the last number covered.

        Raises:
            EndpointError: if the file cannot be read.
        """
        *earlier, current = self._epochs
        known = next((each for each in (*earlier, current) if each.name == epoch), None)
        if self.error and (known is None or known.base + first <= self._written):
            raise EndpointError(str(self.path), self.error)
        if known is None:
            return [], last
        last, found = min(last, known.last) if known is current else last, list[Entry]()
        if self._file and known.base + first <= self._written:
            found = await self._do(self._file.between, replace(known), first, min(last, known.last), limit)
        ids = range(max(self._written, known.base + first - 1) + 1, known.base + min(last, known.last) + 1)
        found = [*found, *(entry for entry in self._memory if entry.id in ids)][:limit]
        return found, found[-1].seq if len(found) == limit else last

    def acknowledge(self, entries: Sequence[Entry]) -> None:
        """Mark entries as received by the broker."""
        epochs = {epoch.name: epoch for epoch in self._epochs}
        for entry in entries:
            if entry.id not in self._acknowledged:
                self._acknowledged.add(entry.id)
                self._unsaved.add(entry.id)
                self.waiting -= 1
            epochs[entry.epoch].sent = max(epochs[entry.epoch].sent, entry.seq)
        self._maintenance_due.set()

    async def close(self) -> None:
        """Write the acknowledgements and close the file."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        with suppress(SlipflowError, TimeoutError):
            async with asyncio.timeout(WRITE_TIMEOUT):
                await (self._recover() if self.error else self._save_acknowledged())
                await self._mark_complete()
        if lost := sum(entry.id > self._written for entry in self._memory):
            log.error("%s: %s; %d events are lost", self.path, self.error, lost)
        with suppress(EndpointError, TimeoutError):
            async with asyncio.timeout(WRITE_TIMEOUT):
                await self._do(self._release)
        self._thread.shutdown(wait=False)
        self._syncer.shutdown(wait=False)

    async def _continue_epoch(self, file: OutboxFile) -> None:
        """Continue the newest epoch unless numbers may be lost, else begin one; mark it as in use."""
        if file.renewed or not self._epochs or self._epochs[-1].boot not in ("", self._boot):
            self._begin_epoch()
        self._epochs[-1].boot = self._boot
        try:
            await self._do(file.mark, self._snapshot())
        except EndpointError as error:
            self._fail(error)

    async def _mark_complete(self) -> None:
        """Make everything durable, and mark the epoch as complete."""
        if self._file and not self.error:
            self._epochs[-1].boot = ""
            await self._do(self._file.mark, self._snapshot())

    async def _append(self, drafts: Sequence[Event]) -> None:
        async with self._appending:
            if self._file and not self.error:
                entries, epoch = self._number(drafts), self._epochs[-1]
                rows = [(entry, True) for entry in entries]
                epochs = [*self._snapshot()[:-1], replace(epoch, last=entries[-1].seq)]
                try:
                    async with asyncio.timeout(WRITE_TIMEOUT * (1 + len(rows) // EVENTS_PER_TIMEOUT)):
                        await self._do(self._file.append, rows, epochs)
                except (EndpointError, TimeoutError) as error:
                    self._doubtful += [entry.id for entry in entries]
                    self._fail(error)
                else:
                    if self._epochs[-1] is not epoch:  # the file failed meanwhile: write them with the rest
                        self._doubtful += [entry.id for entry in entries]
                    else:
                        self._written = entries[-1].id
                        self._unsynced.set()
                    self._take(entries, epoch)
                    return
            self._make_room(len(drafts))
            self._take(self._number(drafts), self._epochs[-1])

    def _number(self, drafts: Sequence[Event]) -> list[Entry]:
        """Return the drafts with numbers of the current epoch; `_take` then advances the epoch."""
        epoch, now, entries = self._epochs[-1], int(time.time()), list[Entry]()
        for seq, draft in enumerate(drafts, epoch.last + 1):
            payload = replace(draft, epoch=epoch.name, seq=seq).encode()
            entries.append(Entry(epoch.base + seq, epoch.name, seq, draft.finger, payload, now))
        self._last = entries[-1].id
        return entries

    def _take(self, entries: list[Entry], epoch: Epoch) -> None:
        epoch.last = entries[-1].seq
        self._memory += entries
        self.waiting += len(entries)
        self._trim()
        self.on_pending()

    def _trim(self) -> None:
        while len(self._memory) > CACHED and self._memory[0].id <= self._durable:
            self._memory.popleft()

    def _make_room(self, count: int) -> None:
        while len(self._memory) + count > MEMORY_MAX:
            oldest = self._memory[0] if self._memory else None
            if oldest is None or (oldest.id > self._written and oldest.id not in self._acknowledged):
                reason = f"{self.error}, and memory is full with {self.waiting} unsent events"
                raise EndpointError(str(self.path), reason)
            self._memory.popleft()

    def _snapshot(self) -> list[Epoch]:
        return [replace(epoch) for epoch in self._epochs]

    def _begin_epoch(self) -> None:
        self._epochs.append(Epoch(token_hex(6), self._last, boot=self._boot))

    def _fail(self, error: BaseException) -> None:
        if self.error:
            return
        self.error = error.reason if isinstance(error, EndpointError) else "the disk does not respond"
        log.error("%s: %s; events are kept in memory until it can be written", self.path, self.error)
        self._begin_epoch()
        self._start(self._keep_recovering())

    async def _keep_recovering(self) -> None:
        retry = BackOff()
        while self.error:
            await asyncio.sleep(retry.delay())
            with suppress(SlipflowError):
                await self._recover()
        log.warning("%s: can be written again; the events kept in memory are in it", self.path)

    async def _recover(self) -> None:
        """Open the file again and write the events kept in memory."""
        if self._lock is None:
            self._lock = await self._do(_lock, self.path)
        file = await self._do(self._reopen)
        known = {epoch.name for epoch in self._epochs}
        self._epochs[:0] = [epoch for epoch in file.epochs if epoch.name not in known]
        if not self._opened:
            self._opened, self.waiting = True, self.waiting + file.waiting
            self._written = max(self._written, file.highest)
        while True:
            unwritten = [entry for entry in self._memory if entry.id > self._written]
            rows = [(entry, entry.id not in self._acknowledged) for entry in unwritten]
            await self._do(file.append, rows, self._snapshot(), self._doubtful.copy())
            self._doubtful.clear()
            if unwritten:
                self._written = unwritten[-1].id
            if not self._memory or self._memory[-1].id <= self._written:
                break
        self.error = ""
        self._unsynced.set()
        self.rewind()  # to the entries of the file, which could not be read meanwhile
        self.on_pending()

    async def _keep_maintained(self) -> None:
        """Write acknowledgements in batches, delete expired entries, and checkpoint the log when idle."""
        pruned = 0.0
        while True:
            await self._maintenance_due.wait()
            last = self._last
            await asyncio.sleep(ACKNOWLEDGE_EVERY)
            self._maintenance_due.clear()
            with suppress(EndpointError):  # retried with the next acknowledgement
                await self._save_acknowledged()
                if self._file and not self.error and time.monotonic() - pruned > PRUNE_EVERY:
                    pruned = time.monotonic()
                    await self._do(self._file.prune, self._keep, time.time() - self._keep_for)
                if self._file and not self.error and self._last == last:
                    await self._do(self._file.checkpoint)

    async def _keep_synced(self) -> None:
        """Sync the file after each write."""
        while True:
            await self._unsynced.wait()
            self._unsynced.clear()
            if (file := self._file) is None or self.error:
                continue  # `_recover` sets it again
            written = self._written
            try:
                async with asyncio.timeout(SYNC_TIMEOUT):
                    await self._run(self._syncer, file.sync)
            except (EndpointError, TimeoutError) as error:
                if file is self._file and not self.error:
                    ids = (entry.id for entry in self._memory)
                    self._doubtful += [each for each in ids if self._durable < each <= self._written]
                    self._written = self._durable
                    self._fail(error)
            else:
                if file is self._file:
                    self._durable = max(self._durable, written)
                    self._trim()

    async def _save_acknowledged(self) -> None:
        if self._file and not self.error and len(self._unsaved):
            saved, self._unsaved = self._unsaved, RangeSet()
            try:
                await self._do(self._file.acknowledge, list(saved), self._snapshot())
            except BaseException:
                self._unsaved = RangeSet([*saved, *self._unsaved])
                raise

    def _reopen(self) -> OutboxFile:
        if self._file:
            self._file.close()
            self._file = None
        self._file = OutboxFile(self.path)
        return self._file

    def _release(self) -> None:
        if self._file:
            self._file.close()
        if self._lock is not None:
            os.close(self._lock)
        self._file = self._lock = None

    def _start(self, work: Coroutine[object, object, None]) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _do(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a call in the outbox's thread."""
        return await self._run(self._thread, partial(call, *args, **kwargs))

    async def _run(self, thread: ThreadPoolExecutor, call: Callable[[], T]) -> T:
        try:
            return await asyncio.get_running_loop().run_in_executor(thread, call)
        except (SqliteError, OSError, Damaged) as error:
            raise EndpointError(str(self.path), f"cannot be used: {reason_of(error)}") from error


def boot_id() -> str:
    """Return the identifier of the system's current boot; a random one if the system has none.

    >>> boot_id() == boot_id()
    True
    """
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return token_hex(16)


def _lock(path: Path) -> int:
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    held = lock_file(path)
    if held is None:
        reason = "is in use: two runs may not publish as one rig; name another rig or outbox"
        raise EndpointError(str(path), reason)
    return held
