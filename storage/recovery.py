"""Recovery of a session whose recorder was killed, or whose files were damaged."""

import os
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from operators.errors import EndpointError, os_error_reason
from storage.description import read_session
from storage.layout import JOURNAL, check_links
from storage.lock import lock


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery."""

    session: str
    rows: Mapping[str, int]  # recovered rows by table
    adopted: tuple[str, ...]  # complete files that were not in the manifest
    lost: tuple[str, ...]  # a line for each loss that was not known before
    cut: tuple[str, ...]  # those of `lost` at the end, where the recorder was killed
    done: tuple[str, ...]  # a line for each other repair

    @property
    def complete(self) -> bool:
        """True if nothing was lost."""
        return not self.lost

    @property
    def changed(self) -> bool:
        """True if anything was repaired or lost."""
        return bool(self.rows or self.adopted or self.lost or self.done)


def recover(folder: str | Path) -> Recovery:
    """Repair a session, so that all its rows are in parts that its manifest lists.

    Complete files that are not listed are added to the manifest, unless they duplicate others. The rows of
    the journal become parts, table by table, up to the first missing row: a table never has a gap. Missing
    parts are reported as lost. Unreadable files, duplicates and a damaged manifest are moved to the folder
    `damaged`. Finally session.json records the recovery, and the journal is deleted. A session that needs
    no repair is not changed; a recovery that was killed can be run again.

    Args:
        folder: Folder of the session.

    Raises:
        InputError: if it is not a session, its journal has another version, or a link leads out of it;
            nothing is changed then.
        EndpointError: if it is being recorded, cannot be written, or the disk fails.
    """
    folder = Path(folder)
    check_links(folder)
    about = read_session(folder)
    try:
        with _exclusive(folder):
            from storage.session_recovery import SessionRecovery  # noqa: PLC0415 - imports pyarrow

            return SessionRecovery(folder, about).finish()
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be recovered: {os_error_reason(error)}") from error


@contextmanager
def _exclusive(folder: Path) -> Generator[None]:
    """Lock a session against recorders and other recoveries."""
    held = list[int]()
    try:
        with suppress(FileNotFoundError):  # concurrent recoveries wait here, and then find no journal
            turn = lock(folder / JOURNAL, wait=True)
            held += [] if turn is None else [turn]
        own = lock(folder)
        if own is None:
            raise EndpointError(str(folder), "is being recorded: recover it when the recording ends")
        held.append(own)
        yield
    finally:
        for number in reversed(held):
            os.close(number)
