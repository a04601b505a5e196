"""A session while it is recorded: rows gather in memory and are committed as Parquet parts."""

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from shutil import rmtree
from threading import Lock

import pyarrow as pa

from operators.batch import EVERY, Batch, Zeroed
from operators.errors import EndpointError, ParameterError
from operators.ports import Run
from storage.description import describe_dataset, describe_session
from storage.episodes import Episodes
from storage.files import make_folder
from storage.layout import EPISODES, SESSIONS, TABLE_OF, TABLES, TOUCH, Table, session_folder
from storage.manifest import Part, write_manifest
from storage.parts import write_part
from storage.schema import to_arrow


@dataclass
class _Buffer:
    """The rows of one table that are not committed yet."""

    kind: type[Batch]  # of all batches of this session
    parts: int = 0  # written before
    batches: list[Batch] = field(default_factory=list[Batch])
    rows: int = 0
    first: int = 0  # ns, earliest event time
    last: int = 0  # ns, latest

    def plus(self, batch: Batch) -> tuple[int, int, int]:
        """What rows, first and last would be with one batch more."""
        first, last = int(batch.time.min()), int(batch.time.max())
        if not self.rows:
            return len(batch), first, last
        return self.rows + len(batch), min(self.first, first), max(self.last, last)


class SessionWriter:
    """One session being written. Apart from `full` and `add`, its methods wait for the disk.

    All tables are committed together, so that their parts cover the same time.
    """

    def __init__(self, root: Path, run: Run, part_span: int, part_rows: int, host: str | None = None) -> None:
        """Make the session's folder and say in it what is known at the beginning.

        Raises:
            EndpointError: if the dataset cannot be written to, or has a session of that name.
            ParameterError: if the session's name is no file name.
            InputError: if dataset.json or a source's description is not as it must be.
        """
        self.folder = session_folder(root, run.session)
        self._root, self._run, self._part_span, self._part_rows = root, run, part_span, part_rows
        self._host = host
        self._episodes = Episodes.described(run.describe)
        self._committed = Episodes.described({}).table
        self._buffers: dict[str, _Buffer] = {}
        self._parts: list[Part] = []
        self._lock = Lock()  # a commit goes on in its thread when the task that awaited it is cancelled
        if root.exists() and not root.is_dir():
            raise EndpointError(str(root), "is a file, must be a folder")
        with self._reporting():
            root.mkdir(parents=True, exist_ok=True)
            describe_dataset(root)
            make_folder(root / SESSIONS)
            try:
                make_folder(self.folder, new=True)
            except FileExistsError:
                reason = f"has a session {run.session!r} already; give this one another name"
                raise EndpointError(str(root), reason) from None
            try:
                describe_session(self.folder, run, host=host)
                self._commit_episodes()
                write_manifest(self.folder, self._parts)
            except BaseException:
                rmtree(self.folder, ignore_errors=True)
                raise

    def full(self, batch: Batch) -> bool:
        """Whether to commit before `batch` is added.

        Raises:
            ParameterError: if no table takes it.
            BatchError: if it is broken: it would spoil the part that it goes into.
        """
        kind, table = type(batch), TABLE_OF.get(type(batch))
        if table is None:
            known = ", ".join(each.__name__ for each in TABLE_OF)
            raise ParameterError("Dataset", "batch", kind.__name__, f"one of {known}")
        if not table.finger and batch.finger != EVERY:
            raise ParameterError("Dataset", f"finger of a {kind.__name__}", batch.finger, f"EVERY ({EVERY})")
        buffer = self._buffers.get(table.name)
        if buffer and buffer.kind is not kind:
            reason = f"{buffer.kind.__name__}: a session keeps either raw or zeroed counts"
            raise ParameterError("Dataset", "batch", kind.__name__, reason)
        if not len(batch.check()) or not table.parted or not buffer or not buffer.rows:
            return False
        rows, first, last = buffer.plus(batch)
        return rows > self._part_rows or last - first >= self._part_span

    def add(self, batch: Batch) -> None:
        """Keep a batch, which `full` has seen, until the next commit."""
        if len(batch):
            with self._lock:
                buffer = self._buffers.setdefault(TABLE_OF[type(batch)].name, _Buffer(type(batch)))
                buffer.rows, buffer.first, buffer.last = buffer.plus(batch)
                buffer.batches.append(batch)

    def commit(self, *, final: bool = False) -> None:
        """Write what has gathered as parts and then the manifest; `final`: the tables of one file, too.

        Raises:
            EndpointError: what could not be committed is kept for the next try.
        """
        with self._lock, self._reporting():
            self._commit_episodes()
            for table in TABLES:
                buffer = self._buffers.get(table.name)
                if buffer and buffer.rows and (table.parted or final):
                    self._commit_rows(table, buffer)
            write_manifest(self.folder, self._parts)

    def close(self) -> None:
        """Commit everything and declare the session ended.

        Raises:
            EndpointError: it may be called again.
        """
        self.commit(final=True)
        touch = self._buffers.get(TOUCH.name)
        with self._reporting():
            zeroed = touch is not None and touch.kind is Zeroed
            describe_session(self.folder, self._run, host=self._host, zeroed=zeroed, ended=True)

    def _commit_rows(self, table: Table, buffer: _Buffer) -> None:
        rows, parts = to_arrow(table, buffer.batches, self._episodes), list[Part]()
        size = self._part_rows if table.parted else len(rows)
        if table.parted:
            make_folder(self.folder / table.name)
        for start in range(0, len(rows), size):  # more than one part only where one batch is larger
            path = table.file(buffer.parts + len(parts))
            parts.append(self._commit_part(path, rows.slice(start, size), "time", "time"))
        self._parts += parts
        self._buffers[table.name] = _Buffer(buffer.kind, buffer.parts + len(parts))

    def _commit_episodes(self) -> None:
        episodes = Episodes.described(self._run.describe)  # a source may tell of them as they begin
        if not episodes.table.equals(self._committed):
            part = self._commit_part(EPISODES, episodes.table, "start", "end")
            self._parts = [*(each for each in self._parts if each.path != EPISODES), part]
            self._committed = episodes.table
        self._episodes = episodes

    def _commit_part(self, path: str, rows: pa.Table, first: str, last: str) -> Part:
        sha256 = write_part(self.folder / path, rows)
        times = int(rows[first].to_numpy().min()), int(rows[last].to_numpy().max())
        return Part(path, len(rows), *times, sha256)

    @contextmanager
    def _reporting(self) -> Generator[None]:
        try:
            yield
        except OSError as error:
            raise EndpointError(str(self._root), f"cannot be written: {error.strerror or error}") from error
