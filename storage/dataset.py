"""Dataset as the sink of a flow."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from operators.batch import Clocks, Episodes, Faults, Labelled, Motion, Slips, Touch, Truth, s
from operators.checks import check_at_least
from operators.ports import Run, Sink

if TYPE_CHECKING:
    from storage.writer import SessionWriter

Recordable: TypeAlias = Touch | Motion | Labelled | Slips | Faults | Clocks | Episodes | Truth


class Dataset(Sink[Recordable]):
    """Folder of recordings; each run becomes a session, see `storage.layout`.

    All rows are committed in order of arrival, in whole parts; readers see whole parts only. The type of a
    batch determines its table: Touch as received, or Zeroed (not both in one session), goes to touch,
    Labelled to samples, each other type to the table of its name.

    The rows of a live run go to a journal at once, and parts are committed in the background: a kill loses
    at most the last 10 rows of a table, a power cut about a second; `storage.recover` turns the journal
    into parts. A replay can be repeated, so its rows have no journal: a kill loses the rows since the last
    commit, a power cut before the end of the session may lose any of them. Such a session is never marked
    complete.

    Several processes may record sessions into one dataset. Disk work runs in threads. After a failed write
    (disk full) the same batch may be written again.

    Args:
        path: Folder of the dataset, created if missing.
        part_span: Longest event time span of a part, ns; default 60 s.
        part_rows: Maximum number of rows of a part.
        host: Name of the machine in session.json; default: its host name.

    Raises:
        ParameterError: if `part_span` or `part_rows` is below 1.
    """

    shared = True
    records = True

    def __init__(
        self, path: str | Path, *, part_span: int = 60 * s, part_rows: int = 100_000, host: str | None = None
    ) -> None:
        check_at_least("Dataset", "part_span", part_span, 1)
        check_at_least("Dataset", "part_rows", part_rows, 1)
        self._root = Path(path).resolve()
        self._part_span, self._part_rows, self._host = part_span, part_rows, host
        self._writer: SessionWriter | None = None
        self._committing: asyncio.Task[None] | None = None

    @property
    def destination(self) -> str:
        """Resolved folder of the dataset."""
        return str(self._root)

    def with_path(self, path: str | Path) -> "Dataset":
        """Return a sink with the same settings that writes to another folder."""
        span, rows, host = self._part_span, self._part_rows, self._host
        return Dataset(path, part_span=span, part_rows=rows, host=host)

    async def open(self, run: Run) -> None:
        """Begin the session `run.session`.

        Raises:
            EndpointError: if the folder cannot be written, or has a session of that name.
            ParameterError: if the name of the session is not a file name.
            InputError: if dataset.json or the description of a source is invalid, or the folder has other
                files and is not a dataset.
        """
        self._writer = await asyncio.to_thread(self._begin, run)

    async def write(self, batch: Recordable) -> None:
        """Write one batch; if the disk is slow, wait until all but 10 rows of its table are in the journal.

        Raises:
            EndpointError: if the disk fails; `batch` was not written.
            ParameterError: if no table has its type.
            BatchError: if it is invalid.
        """
        assert self._writer, "open comes first"
        while self._writer.full(batch):
            await self._commit(self._writer)
        if not self._writer.add(batch):
            await asyncio.to_thread(self._writer.append, batch)

    async def close(self) -> None:
        """Commit all rows and end the session; it is complete if the run has no error.

        Raises:
            EndpointError: if that fails; it may be called again.
        """
        if self._writer:
            if self._committing and not self._committing.done():
                await asyncio.wait([self._committing])
            await asyncio.to_thread(self._writer.close)
            self._writer = self._committing = None

    async def _commit(self, writer: "SessionWriter") -> None:
        """Commit the buffered rows, in the background if the journal has them."""
        if self._committing and not self._committing.done():
            await asyncio.wait([self._committing])
            return
        awaited = writer.failed or not writer.journalled
        writer.begin_commit()
        self._committing = asyncio.create_task(asyncio.to_thread(writer.commit))
        self._committing.add_done_callback(_ignore_failure)
        if awaited:
            await asyncio.wait([self._committing])
            self._committing.result()

    def _begin(self, run: Run) -> "SessionWriter":
        from storage.writer import SessionWriter  # noqa: PLC0415 - imports pyarrow

        return SessionWriter(self._root, run, self._part_span, self._part_rows, self._host)


def _ignore_failure(task: asyncio.Task[None]) -> None:
    """Retrieve the exception, so that asyncio does not log it: the next write repeats the commit."""
    if not task.cancelled():
        task.exception()
