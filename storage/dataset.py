"""A dataset as the sink of a flow."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

from operators.batch import Clocks, Faults, Labelled, Motion, Slips, Touch, s
from operators.errors import ParameterError
from operators.ports import Run, Sink

if TYPE_CHECKING:
    from storage.writer import SessionWriter


class Dataset(Sink[Touch | Motion | Labelled | Slips | Faults | Clocks]):
    """A folder of recordings; each run becomes a session of it, as storage.layout lays it out.

    Every row that `write` took is committed, whole parts at a time, in the order of arrival; a reader sees
    only whole parts. A batch goes to the table of its type: Touch as received, or Zeroed (not both in one
    session), to touch; Labelled to samples; Motion, Slips, Faults and Clocks to their own. A crash loses what
    has gathered since the last commit, and the last three, which are one file each, written at the end.

    Disk work runs in a thread. After a failed write (a full disk, say) the same batch may be written again.

    Args:
        path: The dataset's folder; made if absent.
        part_span: How much event time may gather before it is committed, ns.
        part_rows: How many rows of one table may gather, and the most that a part holds.
        host: What session.json calls the machine; None: by its name.

    Raises:
        ParameterError: if a part could hold nothing.
    """

    def __init__(
        self, path: str | Path, *, part_span: int = 10 * s, part_rows: int = 100_000, host: str | None = None
    ) -> None:
        for name, value in (("part_span", part_span), ("part_rows", part_rows)):
            if value < 1:
                raise ParameterError("Dataset", name, value, "at least 1")
        self._root = Path(path).resolve()
        self._part_span, self._part_rows, self._host = part_span, part_rows, host
        self._writer: SessionWriter | None = None

    @property
    def place(self) -> str:
        """The dataset's folder, resolved."""
        return str(self._root)

    async def open(self, run: Run) -> None:
        """Begin the session `run.session`.

        Raises:
            EndpointError: if the folder cannot be written to, or has a session of that name.
            ParameterError: if the session's name is no file name.
            InputError: if dataset.json or a source's description is not as it must be.
        """
        self._writer = await asyncio.to_thread(self._begin, run)

    async def write(self, batch: Touch | Motion | Labelled | Slips | Faults | Clocks) -> None:
        """Take one batch.

        Raises:
            EndpointError: if what had gathered could not be committed; `batch` was not taken.
            ParameterError: if no table takes it.
            BatchError: if it is broken.
        """
        assert self._writer, "open comes first"
        if self._writer.full(batch):
            await asyncio.to_thread(self._writer.commit)
        self._writer.add(batch)

    async def close(self) -> None:
        """Commit everything and declare the session ended: complete, if the run did not fail.

        Raises:
            EndpointError: if that fails; it may be tried again.
        """
        if self._writer:
            await asyncio.to_thread(self._writer.close)
            self._writer = None

    def _begin(self, run: Run) -> "SessionWriter":
        from storage.writer import SessionWriter  # noqa: PLC0415 - pyarrow takes its time to import

        return SessionWriter(self._root, run, self._part_span, self._part_rows, self._host)
