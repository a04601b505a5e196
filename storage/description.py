"""What a dataset and a session say of themselves: dataset.json and session.json."""

import json
import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, cast

from operators.batch import s
from operators.errors import InputError
from operators.ports import Description, Run
from storage import files
from storage.layout import DATASET, SESSION, SESSIONS, TABLES, Table
from storage.lock import lock

VERSION: Final = 2  # of the layout; 1 had episodes in the descriptions of sources, and no truth


def describe_dataset(root: Path) -> None:
    """Write dataset.json if there is none; of several processes that begin a dataset, one does.

    Raises:
        InputError: if there is one of another version, or there is none among files that are no dataset's.
        OSError: if it cannot be written.
    """
    path = root / DATASET
    if not path.exists():
        held = lock(root, wait=True)
        try:
            if not path.exists():
                if any(not each.name.startswith((".", DATASET, SESSIONS)) for each in root.iterdir()):
                    raise InputError(
                        str(root), "holds other files and is no dataset: give a folder of its own"
                    )
                files.put_json(path, {"format": "slipflow dataset", "version": VERSION})
        finally:
            if held is not None:
                os.close(held)
    _check_version(path, files.read_json(path))


def read_dataset(root: Path) -> Description:
    """What dataset.json says.

    Raises:
        InputError: if it cannot be read, or is of another version.
    """
    about = files.read_json(root / DATASET)
    _check_version(root / DATASET, about)
    return about


def describe_session(
    folder: Path,
    run: Run,
    *,
    host: str | None = None,
    tables: Iterable[Table] = (),
    zeroed: bool = False,
    ended: bool = False,
    put: files.Put = files.put,
) -> None:
    """Write session.json, when a run begins and again when it has `ended`: it is complete if nothing failed.

    `tables` are those that may get rows.

    Raises:
        InputError: if a source's description cannot be JSON.
        OSError: if it cannot be written.
    """
    about: dict[str, Any] = {
        "version": VERSION,
        "session": run.session,
        "flow": run.flow,
        "start": _rfc3339(run.start),
        "start_ns": run.start,
        "software": f"slipflow {version('slipflow')}",
        "host": platform.node() if host is None else host,
        "declaration": list(run.declaration),
        "tables": [table.name for table in tables],
        "sources": {name: dict(each) for name, each in run.describe.items()},
        "split": _split(run.describe.values()),
        "units": {
            table.name: {name: column.unit for name, column in table.columns.items() if column.unit}
            for table in TABLES
        },
        "complete": ended and not run.error,
    }
    if ended:
        end = run.clock.now()
        about |= {
            "end": _rfc3339(end),
            "end_ns": end,
            "error": run.error or None,
            "zeroed": zeroed,
            "streams": {
                name: {"rows": each.rows, "late": each.late, "gaps": [asdict(gap) for gap in each.gaps]}
                for name, each in run.sources.items()
            },
            "sinks": {
                name: {
                    "rows": each.rows,
                    "dropped": each.dropped,
                    "failures": each.failures,
                    "records": each.records,
                }
                for name, each in run.sinks.items()
            },
            "clock_steps": [asdict(step) for step in run.clock_steps],
        }
    try:
        files.put_checked(folder / SESSION, about, put)
    except (TypeError, ValueError) as error:
        culprits = ", ".join(repr(name) for name, each in run.describe.items() if not _tellable(each))
        raise InputError(f"description of source {culprits}", f"cannot be JSON: {error}") from error


def describe_recovery(
    folder: Path, about: Description, recovered: Mapping[str, Any], *, newest: int | None, zeroed: bool
) -> None:
    """Say in session.json what a recovery did.

    Args:
        folder: The session's.
        about: What session.json says.
        recovered: What was done.
        newest: Of all its rows, ns: where a session ends that was not closed; None: it has no rows.
        zeroed: Whether its touch was recorded zeroed.

    Raises:
        OSError: if it cannot be written.
    """
    content: dict[str, Any] = dict(about)
    content["complete"] = about.get("complete") is True and not recovered["lost"]
    content["recovered"] = recovered
    if "end_ns" not in about:
        content |= {"error": "was not closed", "zeroed": zeroed}
        if newest is not None:
            content |= {"end": _rfc3339(newest), "end_ns": newest}
    files.put_checked(folder / SESSION, content)


def read_session(folder: Path) -> Description:
    """What session.json says.

    Raises:
        InputError: if it cannot be read, is damaged, or is of another version.
    """
    path = folder / SESSION
    about = files.read_checked(path)
    _check_version(path, about)
    if not isinstance(about.get("session"), str):
        raise InputError(str(path), 'has no "session", the name of the session: put a copy back')
    return about


def recorders(about: Description) -> tuple[str, ...]:
    """The sinks that kept the rows of a session, by name; none before it is closed.

    >>> recorders({"sinks": {"lab": {"records": True}, "mqtt": {"records": False}}})
    ('lab',)

    Raises:
        AttributeError: if it says of its sinks what no session does.
    """
    sinks = cast("dict[str, dict[str, Any]]", about.get("sinks", {}))
    return tuple(name for name, sink in sinks.items() if sink.get("records"))


def _split(descriptions: Iterable[Description]) -> str | None:
    """Return the split that the sources name, None if none does."""
    named = [split for each in descriptions if isinstance(split := each.get("split"), str)]
    return named[0] if named else None


def _tellable(description: Description) -> bool:
    try:
        json.dumps(description, allow_nan=False)
    except (TypeError, ValueError):
        return False
    return True


def _check_version(path: Path, about: Description) -> None:
    if about.get("version") != VERSION:
        reason = f"has version {about.get('version')!r}, this slipflow reads version {VERSION}"
        raise InputError(str(path), f"{reason}: read it with the slipflow that wrote it, or record it again")


def _rfc3339(time: int) -> str:
    """The instant, ns since 1970-01-01 UTC, as text."""
    return f"{datetime.fromtimestamp(time // s, UTC):%Y-%m-%dT%H:%M:%S}.{time % s:09d}Z"
