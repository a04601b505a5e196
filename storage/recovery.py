"""Putting a session right whose recorder was killed: what its journal holds becomes parts."""

import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from operators.errors import EndpointError, os_error_reason
from storage.description import read_session
from storage.layout import JOURNAL
from storage.lock import lock
from storage.recovered import Recovery


def recover(folder: str | Path) -> Recovery:
    """Put a session right, so that all of it can be read from parts that its manifest lists.

    Files that are whole but not listed are listed, but not what is there twice; a part that is known of and
    gone is told of as lost, by what a damaged manifest still lists or by its number. The rows of the journal
    follow, table by table, up to the first that is missing: a table never has a hole that its reader would
    have to look for. What stands behind damage is kept in the session's folder `damaged`, as are a file that
    was there twice and a damaged manifest. At last session.json says what was done, and the journal goes. A
    session that needs nothing is left alone; killed at any step, it may be called again.

    Args:
        folder: The session's.

    Raises:
        InputError: if it is no session, or its journal is of another version; nothing is changed then.
        EndpointError: if it is being recorded, or cannot be written to.
    """
    folder = Path(folder)
    about = read_session(folder)
    with _alone(folder):
        from storage.salvage import Salvage  # noqa: PLC0415 - it imports pyarrow

        try:
            return Salvage(folder, about).carry_out()
        except OSError as error:
            raise EndpointError(str(folder), f"cannot be recovered: {os_error_reason(error)}") from error


@contextmanager
def _alone(folder: Path) -> Generator[None]:
    """Nobody records the session, or recovers it, meanwhile."""
    held = list[int]()
    try:
        with suppress(FileNotFoundError):  # those who recover wait for each other; then there is no journal
            turn = lock(folder / JOURNAL, wait=True)
            held += [] if turn is None else [turn]
        own = lock(folder)
        if own is None:
            raise EndpointError(str(folder), "is being recorded just now; recover it when that has ended")
        held.append(own)
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be locked: {os_error_reason(error)}") from error
    else:
        yield
    finally:
        for number in reversed(held):
            os.close(number)
