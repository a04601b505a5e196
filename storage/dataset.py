"""Dataset as the sink of a flow."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeAlias

from operators.batch import Episodes, Faults, Labelled, Motion, Slips, Touch, Truth
from operators.errors import EndpointError
from operators.ports import Clock, Finding, Run, Sink
from storage.background_task import BackgroundTask
from storage.files import check_disk
from storage.journal import APPEND_AT, Journal
from storage.parts import PART_ROWS, PART_SPAN
from storage.writer import SessionWriter

Recordable: TypeAlias = Touch | Motion | Labelled | Slips | Faults | Episodes | Truth

APPEND_INTERVAL: Final = 0.05  # s; a row waits no longer for the journal
SYNC_INTERVAL: Final = 0.2  # s, from the end of an fsync of the journal to the next


class Dataset(Sink[Recordable]):
    """Folder of recordings; each run becomes a session, see docs/reference/dataset.md.

    All rows are committed in order of arrival, in whole parts; readers see whole parts only. The type of a
    batch determines its table: Touch as received, or Zeroed (not both in one session), goes to touch,
    Labelled to samples, each other type to the table of its name.

    The rows of a live run go to a journal within 50 ms, and parts are committed in the background; while that
    is slow, a part may become longer than 60 s. A kill loses at most the last 10 rows of a table that
    the dataset has taken, or a larger batch that is being written; a power cut loses the rows of at most
    0.3 s on a disk that syncs within 50 ms. `storage.recover` turns the journal into parts.

    A replay can be repeated, so its rows have no journal and are not made durable. `slipflow` writes it under
    another name and renames it when it is complete and durable.

    Several processes may record sessions into one dataset. Disk work runs in threads. After a failed write
    (disk full) the same batch may be written again.

    Args:
        path: Folder of the dataset, created if missing.
    """

    shared = True
    records = True
    part_span = PART_SPAN  # smaller in tests, as part_rows
    part_rows = PART_ROWS

    def __init__(self, path: str | Path) -> None:
        self._root = Path(path).resolve()
        self._writer: SessionWriter | None = None
        self._tasks: tuple[BackgroundTask, ...] = ()  # that append and sync rows of a live run
        self._committing: asyncio.Task[None] | None = None
        self._appending = asyncio.Lock()  # held during an append, and a commit that allows none
        self._urgent = asyncio.Event()  # rows are to be appended at once

    @property
    def destination(self) -> str:
        """Resolved folder of the dataset."""
        return str(self._root)

    @property
    def pending(self) -> int:
        """Rows that are neither in a part nor in the journal."""
        return self._writer.pending if self._writer else 0

    async def diagnose(self, clock: Clock) -> AsyncGenerator[Finding]:
        """Check the free space of the disk and the time of an fsync."""
        for finding in await asyncio.to_thread(check_disk, self._root):
            yield finding

    async def open(self, run: Run) -> None:
        """Begin the session `run.session`.

        Raises:
            EndpointError: if the folder cannot be written, or has a session of that name.
            ParameterError: if the name of the session is not a file name.
            InputError: if dataset.json or the description of a source is invalid, or the folder has other
                files and is not a dataset.
        """
        bounds = self.part_span, self.part_rows
        self._writer = await asyncio.to_thread(SessionWriter, self._root, run, *bounds)
        self._tasks, self._appending = (), asyncio.Lock()  # a later run may have another event loop
        self._urgent = asyncio.Event()
        if journal := self._writer.journal:
            works = self._keep_appending(self._writer, journal), self._keep_syncing(journal)
            self._tasks = tuple(
                BackgroundTask(self.destination, "the writing of new rows", each) for each in works
            )

    def take(self, batch: Recordable) -> bool:
        """Buffer one batch, or return False if that has to wait for the disk."""
        writer = self._writer
        assert writer, "open comes first"
        if (writer.full(batch) and not self._commit_meanwhile(writer, batch)) or not writer.add(batch):
            return False
        self._notice(writer)
        return True

    async def write(self, batch: Recordable) -> None:
        """Write one batch; if the disk is slow, wait until all but 10 rows of its table are in the journal.

        A batch of more than 10 rows is in the journal when this returns.

        Raises:
            EndpointError: if the disk fails; `batch` was not written.
            ParameterError: if no table has its type.
            BatchError: if it is invalid.
        """
        while not self.take(batch):
            writer = self._writer
            assert writer, "open comes first"
            if not writer.full(batch) or self._commit_meanwhile(writer, batch):
                return await self._append(writer, batch)
            await self._commit(writer)
        return None

    async def close(self) -> None:
        """Commit all rows and end the session; it is complete if the run has no error.

        Raises:
            EndpointError: if that fails; it may be called again. Also if rows were not made durable in time
                because of a failure in this class; then the session is ended.
        """
        if self._writer is None:
            return
        for task in self._tasks:
            await task.end()
        if self._committing:
            await asyncio.wait([self._committing])
        async with self._appending:
            await asyncio.to_thread(self._writer.close)
        self._writer = self._committing = None
        for task in self._tasks:
            task.check()

    def _notice(self, writer: SessionWriter) -> None:
        """Wake up the task that appends, if many rows wait."""
        if writer.journal and writer.journal.waiting >= APPEND_AT:
            self._urgent.set()

    async def _append(self, writer: SessionWriter, batch: Recordable | None = None) -> None:
        """Append the waiting rows to the journal, then a batch that `take` refused.

        A cancellation does not stop the thread, which holds the lock until it has ended.
        """

        async def append() -> None:
            async with self._appending:
                if batch is None or not writer.add(batch):
                    await asyncio.to_thread(writer.append, batch)

        await asyncio.shield(asyncio.create_task(append()))
        self._notice(writer)

    async def _keep_appending(self, writer: SessionWriter, journal: Journal) -> None:
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(APPEND_INTERVAL):
                    await self._urgent.wait()
            self._urgent.clear()
            if journal.waiting:
                with suppress(EndpointError):  # the next write reports it
                    await self._append(writer)

    async def _keep_syncing(self, journal: Journal) -> None:
        while True:
            await asyncio.sleep(SYNC_INTERVAL)
            if journal.unsynced:
                with suppress(OSError):  # the next write commits all rows from memory
                    await asyncio.to_thread(journal.sync)

    def _commit_meanwhile(self, writer: SessionWriter, batch: Recordable) -> bool:
        """Commit the buffered rows in the background; return true if a batch may be added meanwhile.

        The journal has the rows. So a slow commit does not make rows wait, and a kill does not lose them.
        """
        if writer.exclusive:
            return False
        if self._committing is None or self._committing.done():
            self._begin_commit(writer)
        return writer.fits(batch)

    async def _commit(self, writer: SessionWriter) -> None:
        """Wait for the commit that is running, else commit the buffered rows."""
        if self._committing and not self._committing.done():
            await asyncio.wait([self._committing])
            return
        await asyncio.shield(self._begin_commit(writer))

    def _begin_commit(self, writer: SessionWriter) -> asyncio.Task[None]:
        writer.begin_commit()
        self._committing = asyncio.create_task(self._run_commit(writer))
        self._committing.add_done_callback(
            lambda task: task.cancelled() or task.exception()
        )  # so asyncio logs none
        return self._committing

    async def _run_commit(self, writer: SessionWriter) -> None:
        async with self._appending:  # wait for an append to a segment that the commit may delete
            if writer.exclusive:
                await asyncio.to_thread(writer.commit)
                return
        await asyncio.to_thread(writer.commit)
