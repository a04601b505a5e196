"""Descriptions of a dataset and a session: dataset.json and session.json."""

import hashlib
import json
import platform
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, is_dataclass
from datetime import UTC, datetime
from pathlib import Path
from re import sub
from types import FunctionType, MappingProxyType
from typing import Any, Final, cast

import numpy as np

from operators.batch import s
from operators.errors import InputError
from operators.extras import software_version
from operators.ports import Description, Run
from storage import files
from storage.layout import DATASET, SESSION, SESSIONS, TABLE_OF, TABLES

VERSION: Final = 2  # of the dataset format
UNKNOWN: Final[Description] = MappingProxyType({})  # instead of a session.json that cannot be read
_IDENTITY: Final = ("session", "start_ns")
_ALLOWED: Final = (".", DATASET, SESSIONS, "lost+found")  # starts of names in a new dataset; ext4's too


class VersionError(InputError):
    """Dataset or session of another version of the format."""


def describe_dataset(root: Path) -> None:
    """Write dataset.json if there is none; only one of several processes does so.

    Raises:
        InputError: if it has another version, or the folder has other files and is not a dataset.
    """
    path = root / DATASET
    if not path.exists():
        with files.exclusive(root):
            if not path.exists():
                if any(not each.name.startswith(_ALLOWED) for each in root.iterdir()):
                    raise InputError(str(root), "has other files and is not a dataset: give another folder")
                files.put_json(path, {"format": "slipflow dataset", "version": VERSION})
    read_dataset(root)


def read_dataset(root: Path) -> Description:
    """Return the content of dataset.json."""
    about = files.read_json(root / DATASET)
    _check_version(root / DATASET, about)
    return about


def describe_session(folder: Path, run: Run, destination: str, *, ended: bool = False) -> None:
    """Write session.json at the start of a run, and when it has `ended`; without error it is complete then.

    The run names its tables and fingertips by `destination`, the folder of the dataset.

    Raises:
        InputError: if the description of a source is not JSON.
    """
    kinds, fingertips = run.sink_types.get(destination, {}), run.fingertips.get(destination, {})
    about: dict[str, Any] = {
        "version": VERSION,
        "session": run.session,
        "flow": run.flow,
        "start": _rfc3339(run.start),
        "start_ns": run.start,
        "software": f"slipflow {software_version()}",
        "host": platform.node() if run.live else None,  # a replay is the same on every machine
        "declaration": list(run.declaration),
        "tables": [table.name for table in TABLES if table in map(TABLE_OF.get, kinds)],
        "sources": {name: dict(each) for name, each in run.describe.items()},
        "fingertips": {
            TABLE_OF[kind].name: each.describe() for kind, each in fingertips.items() if kind in TABLE_OF
        },
        "split": _named("split", run.describe.values()),
        "group": _named("group", run.describe.values()),
        "complete": ended and not run.error,
    }
    if ended:
        end = run.clock.now()
        about |= {
            "end": _rfc3339(end),
            "end_ns": end,
            "error": run.error or None,
            "streams": {
                name: {"rows": each.rows, "late": each.late, "gaps": [asdict(gap) for gap in each.gaps]}
                for name, each in run.sources.items()
            },
            "sinks": {
                name: {key: getattr(each, key) for key in ("rows", "dropped", "failures", "records")}
                for name, each in run.sinks.items()
            },
            "clock_steps": [asdict(step) for step in run.clock_steps],
        }
    for name, each in run.describe.items():
        try:
            json.dumps(each, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InputError(f"description of source {name!r}", f"is not JSON: {error}") from error
    files.put_checked(folder / SESSION, about, durable=run.live)


def describe_recovery(
    folder: Path, about: Description, recovered: Mapping[str, Any], *, newest: int | None
) -> None:
    """Record a recovery in session.json; `newest` (ns) ends a session that was not closed."""
    content: dict[str, Any] = dict(about)
    content["complete"] = about.get("complete") is True and not recovered["lost"]
    content["recovered"] = recovered
    if "end_ns" not in about:
        content["error"] = "was not closed"
        if newest is not None:
            content |= {"end": _rfc3339(newest), "end_ns": newest}
    files.put_checked(folder / SESSION, content)


def read_session(folder: Path) -> Description:
    """Return the content of session.json.

    Raises:
        InputError: if it cannot be read, is damaged or invalid, or has another version.
    """
    path = folder / SESSION
    about = files.read_checked(path)
    _check_version(path, about)
    if not isinstance(about.get("session"), str):
        raise InputError(str(path), 'has no "session", the name of the session: restore a copy')
    if not _can_be_recovered(about):
        raise InputError(str(path), 'has an invalid entry "recovered": restore a copy')
    return about


def identity(about: Description) -> dict[str, object]:
    """Return the entries by which other documents of a session name it; empty if session.json is unknown."""
    return {key: about[key] for key in _IDENTITY if key in about}


def check_identity(path: Path, content: Mapping[str, Any], about: Description) -> None:
    """Check that a document belongs to the session; one of an older version does not name it.

    Raises:
        InputError: if it names another session.
    """
    named, own = identity(content), identity(about)
    if named and own and named != own:
        one, other = (f"{each.get('session')!r} of {each.get('start_ns')} ns" for each in (named, own))
        raise InputError(str(path), f"belongs to session {one}, but {SESSION} to {other}: restore its own")


def _can_be_recovered(about: Description) -> bool:
    """Return true if the entries that a recovery uses have the right types."""
    recovered = about.get("recovered", {})
    return isinstance(recovered, dict) and all(
        isinstance(recovered.get(key, kind()), kind)
        for key, kind in (("rows", dict), ("lost", list), ("cut", list))
    )


def _named(key: str, descriptions: Iterable[Description]) -> str | None:
    """Return the split or group that a source names, None if none does."""
    return next((value for each in descriptions if isinstance(value := each.get(key), str)), None)


def _check_version(path: Path, about: Description) -> None:
    version = about.get("version")
    if version != VERSION:
        kind = VersionError if isinstance(version, int) else InputError
        reason = f"has version {version!r}; this slipflow reads version {VERSION}"
        raise kind(str(path), f"{reason}: read it with the slipflow that wrote it, or record it again")


def _rfc3339(time: int) -> str:
    """Return a time (ns since 1970-01-01 UTC) as text."""
    return f"{datetime.fromtimestamp(time // s, UTC):%Y-%m-%dT%H:%M:%S}.{time % s:09d}Z"


def plain_text(value: object) -> str:
    """Return the text of a value without its address, which differs in each process."""
    return sub(" at 0x[0-9a-fA-F]+", "", repr(value))


def checksum(value: object) -> str:
    """Return the checksum of what a value consists of, such as a detector; the same in each process."""
    return f"sha256 {hashlib.sha256(repr([*_contents(value)]).encode()).hexdigest()}"


def _contents(value: object, *, inner: bool = False) -> Iterator[str]:
    """Yield what a value consists of; only the text of an object in an object."""
    if isinstance(value, np.ndarray):
        yield f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    elif isinstance(value, Mapping | list | tuple):
        for each in cast("Any", value.items() if isinstance(value, Mapping) else value):
            yield from _contents(each, inner=True)
    elif isinstance(value, type | FunctionType):
        yield f"{value.__module__}.{value.__qualname__}"
    else:
        parts = getattr(value, "__dict__", {}) if is_dataclass(value) or not inner else {}
        yield type(value).__qualname__ if parts else plain_text(value)
        for name, each in parts.items():
            weights = isinstance(each, np.ndarray | np.generic | float | list | tuple)
            if weights or not name.startswith("_"):  # other private attributes may be caches
                yield from _contents((name, each))
