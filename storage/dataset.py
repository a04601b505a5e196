"""A dataset as the sink of a flow."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from operators.batch import Clocks, Episodes, Faults, Labelled, Motion, Slips, Touch, Truth, s
from operators.errors import ParameterError
from operators.ports import Run, Sink

if TYPE_CHECKING:
    from storage.writer import SessionWriter

Rows: TypeAlias = Touch | Motion | Labelled | Slips | Faults | Clocks | Episodes | Truth


class Dataset(Sink[Rows]):
    """A folder of recordings; each run becomes a session of it, as storage.layout lays it out.

    Every row that `write` took is committed, whole parts at a time, in the order of arrival; a reader sees
    only whole parts. A batch goes to the table of its type: Touch as received, or Zeroed (not both in one
    session), to touch; Labelled to samples; every other type to the table of its name.

    The rows of a live run go to a journal at once, and parts are committed behind its back: what is killed
    loses at most the last 10 rows of a table, a power cut about a second; `storage.recover` puts the journal
    into parts. Rows of a replay, which can be made again, have no journal: a kill loses what had gathered, a
    power cut before the session has ended any of it. Such a session is never complete.

    Several processes may record into one dataset, each sessions of its own. Disk work runs in threads. After
    a failed write (a full disk, say) the same batch may be written again.

    Args:
        path: The dataset's folder; made if absent.
        part_span: How much event time may gather before it is committed, ns.
        part_rows: How many rows of one table may gather, and the most that a part holds.
        host: What session.json calls the machine; None: by its name.

    Raises:
        ParameterError: if a part could hold nothing.
    """

    shared = True
    records = True

    def __init__(
        self, path: str | Path, *, part_span: int = 60 * s, part_rows: int = 100_000, host: str | None = None
    ) -> None:
        for name, value in (("part_span", part_span), ("part_rows", part_rows)):
            if value < 1:
                raise ParameterError("Dataset", name, value, "at least 1")
        self._root = Path(path).resolve()
        self._part_span, self._part_rows, self._host = part_span, part_rows, host
        self._writer: SessionWriter | None = None
        self._committing: asyncio.Task[None] | None = None

    @property
    def destination(self) -> str:
        """The dataset's folder, resolved."""
        return str(self._root)

    def moved(self, path: str | Path) -> "Dataset":
        """A sink like this one that writes to another folder."""
        span, rows, host = self._part_span, self._part_rows, self._host
        return Dataset(path, part_span=span, part_rows=rows, host=host)

    async def open(self, run: Run) -> None:
        """Begin the session `run.session`.

        Raises:
            EndpointError: if the folder cannot be written to, or has a session of that name.
            ParameterError: if the session's name is no file name.
            InputError: if dataset.json or a source's description is not as it must be, or the folder holds
                other files and is no dataset.
        """
        self._writer = await asyncio.to_thread(self._begin, run)

    async def write(self, batch: Rows) -> None:
        """Take one batch; while the disk is slow, wait until all but 10 rows of its table are in the journal.

        Raises:
            EndpointError: if what had gathered could not be written; `batch` was not taken.
            ParameterError: if no table takes it.
            BatchError: if it is broken.
        """
        assert self._writer, "open comes first"
        while self._writer.full(batch):
            await self._commit(self._writer)
        if not self._writer.add(batch):
            await asyncio.to_thread(self._writer.append, batch)

    async def close(self) -> None:
        """Commit everything and declare the session ended: complete, if the run did not fail.

        Raises:
            EndpointError: if that fails; it may be tried again.
        """
        if self._writer:
            if self._committing and not self._committing.done():
                await asyncio.wait([self._committing])
            await asyncio.to_thread(self._writer.close)
            self._writer = self._committing = None

    async def _commit(self, writer: "SessionWriter") -> None:
        """Commit what has gathered: behind our back where the journal has it, unless it failed before."""
        if self._committing and not self._committing.done():
            await asyncio.wait([self._committing])
            return
        awaited = writer.behind or not writer.journalled
        writer.take()
        self._committing = asyncio.create_task(asyncio.to_thread(writer.commit))
        self._committing.add_done_callback(_heard)
        if awaited:
            await asyncio.wait([self._committing])
            self._committing.result()

    def _begin(self, run: Run) -> "SessionWriter":
        from storage.writer import SessionWriter  # noqa: PLC0415 - pyarrow takes its time to import

        return SessionWriter(self._root, run, self._part_span, self._part_rows, self._host)


def _heard(task: asyncio.Task[None]) -> None:
    """A failure is not lost: `writer.behind` tells the next write of it, which tries again."""
    if not task.cancelled():
        task.exception()
