"""The outbox: slip events are numbered and written down before they are sent, and kept to be sent again."""

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
from connectors.mqtt.numbers import Numbers
from connectors.mqtt.outbox_file import Damaged, Entry, Epoch, OutboxFile, is_full, reason_of
from connectors.mqtt.outbox_place import boot, lock
from operators.errors import EndpointError, SlipflowError

P = ParamSpec("P")
T = TypeVar("T")

log = logging.getLogger("slipflow")

PATIENCE = 1.0  # s that an event waits for the disk before it is sent without
MANY = 1000  # events for which it waits that long again
SLOWEST = 10.0  # s that the disk may take to make events durable
RECENT = 256  # events kept in memory, so that none is read back while it is new
MEMORY = 10_000  # events that memory holds at most while the file cannot be written
NOTE_EVERY = 0.2  # s, in which acknowledgements gather
PRUNE_EVERY = 10.0  # s
FIRST_RETRY = 0.1  # s
LAST_RETRY = 5.0  # s, up to which the back-off doubles
ANNOUNCED = 12  # newest epochs that the head tells of


class Outbox:
    """The numbered events of one rig, in a file that outlives the run, used by one process at a time.

    An epoch is a series of numbers; it belongs to the file and goes on from run to run. What is in the file
    survives the process, and goes out while another thread makes it durable: waiting for that would save no
    event from a power cut, only number none twice. Instead, where numbers may have been lost, for the system
    has been started anew since they were given, a new epoch begins.

    While the file cannot be written, events are numbered in memory, in an epoch of their own for the same
    reason. They are written once that works; killed before, they may be lost.
    """

    def __init__(self, path: Path, *, keep: int, keep_for: float) -> None:
        """Get ready to use `path`: it keeps `keep` events for `keep_for` s, and all that were not sent."""
        self.path, self._keep, self._keep_for = path, keep, keep_for
        self.on_news: Callable[[], object] = lambda: None  # called when there is something to send
        self.waiting = 0  # events to be sent
        self.error = ""  # why the file cannot be written; empty while it can
        self._thread = ThreadPoolExecutor(1, "slipflow-outbox")
        self._syncer = ThreadPoolExecutor(1, "slipflow-outbox-sync")
        self._boot = boot()
        self._lock: int | None = None
        self._file: OutboxFile | None = None
        self._opened = False  # ever
        self._epochs: list[Epoch] = []  # oldest first; numbers are given in the last
        self._memory = deque[Entry]()  # the newest
        self._durable = self._written = self._last = 0  # ids: of the newest that is, in the file, given
        self._read = 0  # id of the newest that `next` gave
        self._doubtful = list[int]()  # ids that may be in the file and must not
        self._acknowledged = Numbers()  # ids
        self._unnoted = Numbers()  # those of them that the file does not know of
        self._untidy, self._unsynced = asyncio.Event(), asyncio.Event()
        self._appending = asyncio.Lock()
        self._tasks = set[asyncio.Task[None]]()

    async def open(self) -> None:
        """Open the file, or begin in memory where the disk is full.

        Raises:
            EndpointError: if another run uses it, or it cannot be written.
            InputError: if it is something else.
        """
        try:
            self._lock = await self._do(lock, self.path)
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
            await self._go_on(self._file)
        self._start(self._keep_tidy())
        self._start(self._keep_synced())

    @property
    def epoch(self) -> str:
        """The series in which numbers are given."""
        return self._epochs[-1].name

    def heads(self) -> list[tuple[str, int]]:
        """The newest epochs, the present one last, with the newest number of each that the broker has."""
        return [(epoch.name, epoch.sent) for epoch in self._epochs[-ANNOUNCED:]]

    async def append(self, drafts: Sequence[Event]) -> None:
        """Give events their epoch and number, and keep them; what they say of these is ignored.

        Raises:
            EndpointError: if the file cannot be written and memory is full; then none was taken.
        """
        if drafts:
            await asyncio.shield(self._start(self._append(drafts)))  # whole or not at all

    async def next(self, limit: int) -> list[Entry]:
        """The next entries that wait to be sent, each once until `rewind`; [] when there is none."""
        found = list[Entry]()
        if self._file and not self.error and not (self._memory and self._read >= self._memory[0].id - 1):
            try:
                await self._note()
                found = await self._do(self._file.waiting_after, self._read, limit)
            except EndpointError as error:
                self._fail(error)  # alerts go on
        found = [entry for entry in found if entry.id not in self._acknowledged] or [
            entry for entry in self._memory if entry.id > self._read and entry.id not in self._acknowledged
        ]
        found = found[:limit]
        self._read = found[-1].id if found else self._read
        return found

    def rewind(self, before: int = 1) -> None:
        """Let `next` begin again at an id, with what was not acknowledged."""
        self._read = min(self._read, before - 1)

    async def between(self, epoch: str, first: int, last: int, limit: int) -> tuple[list[Entry], int]:
        """Entries `first` to `last` of an epoch, at most `limit`, and the number up to which these are all.

        Raises:
            EndpointError: if the file cannot be read.
        """
        *before, present = self._epochs
        known = next((each for each in (*before, present) if each.name == epoch), None)
        if self.error and (known is None or known.base + first <= self._written):
            raise EndpointError(str(self.path), self.error)
        if known is None:
            return [], last
        last, found = min(last, known.last) if known is present else last, list[Entry]()
        if self._file and known.base + first <= self._written:
            found = await self._do(self._file.between, replace(known), first, min(last, known.last), limit)
        ids = range(max(self._written, known.base + first - 1) + 1, known.base + min(last, known.last) + 1)
        found = [*found, *(entry for entry in self._memory if entry.id in ids)][:limit]
        return found, found[-1].seq if len(found) == limit else last

    def acknowledge(self, entries: Sequence[Entry]) -> None:
        """The broker has them."""
        epochs = {epoch.name: epoch for epoch in self._epochs}
        for entry in entries:
            if entry.id not in self._acknowledged:
                self._acknowledged.add(entry.id)
                self._unnoted.add(entry.id)
                self.waiting -= 1
            epochs[entry.epoch].sent = max(epochs[entry.epoch].sent, entry.seq)
        self._untidy.set()

    async def close(self) -> None:
        """Note what was acknowledged, and let go of the file."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        with suppress(SlipflowError, TimeoutError):
            async with asyncio.timeout(PATIENCE):
                await (self._heal() if self.error else self._note())
                await self._part()
        if lost := sum(entry.id > self._written for entry in self._memory):
            log.error("%s: %s; %d events could not be kept", self.path, self.error, lost)
        with suppress(EndpointError, TimeoutError):
            async with asyncio.timeout(PATIENCE):
                await self._do(self._let_go)
        self._thread.shutdown(wait=False)
        self._syncer.shutdown(wait=False)

    async def _go_on(self, file: OutboxFile) -> None:
        """Go on in the newest epoch if none of its numbers can have been lost, and note that some now may."""
        if file.renewed or not self._epochs or self._epochs[-1].boot not in ("", self._boot):
            self._begin()
        self._epochs[-1].boot = self._boot
        try:
            await self._do(file.mark, self._snapshot())
        except EndpointError as error:
            self._fail(error)

    async def _part(self) -> None:
        """Make all durable, and note that no number can be lost any more."""
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
                    async with asyncio.timeout(PATIENCE * (1 + len(rows) // MANY)):
                        await self._do(self._file.append, rows, epochs)
                except (EndpointError, TimeoutError) as error:
                    self._doubtful += [entry.id for entry in entries]
                    self._fail(error)
                else:
                    if self._epochs[-1] is not epoch:  # it failed meanwhile: they are written with the rest
                        self._doubtful += [entry.id for entry in entries]
                    else:
                        self._written = entries[-1].id
                        self._unsynced.set()
                    self._take(entries, epoch)
                    return
            self._make_room(len(drafts))
            self._take(self._number(drafts), self._epochs[-1])

    def _number(self, drafts: Sequence[Event]) -> list[Entry]:
        """Entries in the present epoch, which has them once they are taken."""
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
        self.on_news()

    def _trim(self) -> None:
        while len(self._memory) > RECENT and self._memory[0].id <= self._durable:
            self._memory.popleft()

    def _make_room(self, count: int) -> None:
        while len(self._memory) + count > MEMORY:
            oldest = self._memory[0] if self._memory else None
            if oldest is None or (oldest.id > self._written and oldest.id not in self._acknowledged):
                reason = f"{self.error}, and memory takes no more than the {self.waiting} events that wait"
                raise EndpointError(str(self.path), reason)
            self._memory.popleft()

    def _snapshot(self) -> list[Epoch]:
        return [replace(epoch) for epoch in self._epochs]

    def _begin(self) -> None:
        """Begin a new epoch."""
        self._epochs.append(Epoch(token_hex(6), self._last, boot=self._boot))

    def _fail(self, error: BaseException) -> None:
        if self.error:
            return
        self.error = error.reason if isinstance(error, EndpointError) else "the disk does not answer"
        log.error("%s: %s; events go on, kept in memory until it works", self.path, self.error)
        self._begin()
        self._start(self._keep_healing())

    async def _keep_healing(self) -> None:
        delay = FIRST_RETRY
        while self.error:
            await asyncio.sleep(delay)
            delay = min(2 * delay, LAST_RETRY)
            with suppress(SlipflowError):
                await self._heal()
        log.warning("%s: works again, and holds what was kept in memory", self.path)

    async def _heal(self) -> None:
        """Open the file again and write what gathered in memory."""
        if self._lock is None:
            self._lock = await self._do(lock, self.path)
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
        self.rewind()  # what the file holds could not be read meanwhile
        self.on_news()

    async def _keep_tidy(self) -> None:
        """Write down acknowledgements, many at a time; forget what is too old; in a pause empty the log."""
        pruned = 0.0
        while True:
            await self._untidy.wait()
            last = self._last
            await asyncio.sleep(NOTE_EVERY)
            self._untidy.clear()
            with suppress(EndpointError):  # they gather on; should it last, the next event will tell
                await self._note()
                if self._file and not self.error and time.monotonic() - pruned > PRUNE_EVERY:
                    pruned = time.monotonic()
                    await self._do(self._file.prune, self._keep, time.time() - self._keep_for)
                if self._file and not self.error and self._last == last:
                    await self._do(self._file.checkpoint)

    async def _keep_synced(self) -> None:
        """Have what was written made durable, as soon as the disk can."""
        while True:
            await self._unsynced.wait()
            self._unsynced.clear()
            if (file := self._file) is None or self.error:
                continue  # healing says when
            written = self._written
            try:
                async with asyncio.timeout(SLOWEST):
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

    async def _note(self) -> None:
        if self._file and not self.error and len(self._unnoted):
            noted, self._unnoted = self._unnoted, Numbers()
            try:
                await self._do(self._file.acknowledge, list(noted), self._snapshot())
            except BaseException:
                self._unnoted = Numbers([*noted, *self._unnoted])
                raise

    def _reopen(self) -> OutboxFile:
        if self._file:
            self._file.close()
            self._file = None
        self._file = OutboxFile(self.path)
        return self._file

    def _let_go(self) -> None:
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
        """Run it in the outbox's thread."""
        return await self._run(self._thread, partial(call, *args, **kwargs))

    async def _run(self, thread: ThreadPoolExecutor, call: Callable[[], T]) -> T:
        try:
            return await asyncio.get_running_loop().run_in_executor(thread, call)
        except (SqliteError, OSError, Damaged) as error:
            raise EndpointError(str(self.path), f"cannot be used: {reason_of(error)}") from error
