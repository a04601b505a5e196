"""Recovery of a session whose recorder was killed, or whose files were damaged."""

import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from operators.errors import EndpointError, os_error_reason
from storage.description import read_session
from storage.layout import JOURNAL
from storage.lock import lock
from storage.recovery_result import Recovery


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
        InputError: if it is not a session, or its journal has another version; nothing is changed then.
        EndpointError: if it is being recorded, or cannot be written.
    """
    folder = Path(folder)
    about = read_session(folder)
    with _exclusive(folder):
        from storage.session_recovery import SessionRecovery  # noqa: PLC0415 - imports pyarrow

        try:
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
            _close(held)
            raise EndpointError(str(folder), "is being recorded: recover it when the recording ends")
        held.append(own)
    except OSError as error:
        _close(held)
        raise EndpointError(str(folder), f"cannot be locked: {os_error_reason(error)}") from error
    try:
        yield
    finally:
        _close(held)


def _close(held: list[int]) -> None:
    for number in reversed(held):
        os.close(number)
