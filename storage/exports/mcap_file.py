"""Export of a session to one MCAP file, for Foxglove: every row is a JSON message, in time order.

Columns have the same names as in Parquet. Timestamps and durations in ns become ``{"sec", "nsec"}``, which
Foxglove shows as times and which no reader rounds. JSON has no NaN: values that are not finite become null,
and a column without any finite value is omitted from its message.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from operators.batch import BAROMETERS, EVERY, Batch, s
from operators.column import Column
from operators.errors import InputError
from operators.extras import require_extra
from storage.files import partial_output
from storage.layout import FAULTS, SLIPS, TABLES, Table
from storage.session import Session

_CHUNK: Final = 1 << 20  # bytes of messages per compressed chunk
_TYPES: Final = {"b": "boolean", "i": "integer", "f": "number"}
_STAMP: Final = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_Message: TypeAlias = tuple[int, str, bytes]  # time (ns), topic, JSON


def export(session: Session, path: Path) -> Mapping[str, int]:
    """Write a session; return the number of messages of each topic.

    Streams are read part by part and merged, so memory does not grow with the session. Late rows are in the
    order of recording; the file's index sorts them by time. session.json becomes the metadata record
    "session", with JSON text for each key; labels given by hand become "hand_labels", if there are any.

    Raises:
        InputError: if the library is not installed, the session is damaged, or a row is from before 1970.
        EndpointError: if the file exists or cannot be written; then nothing is left of it.

    References:
        MCAP format specification, https://mcap.dev/spec
    """
    require_extra("mcap", "MCAP export")
    from mcap.writer import Writer

    with partial_output(path, Path.touch) as scratch, scratch.open("wb") as file:
        writer: Any = Writer(file, chunk_size=_CHUNK)
        writer.start(profile="", library=_text(session.about.get("software", "slipflow")))
        labels = session.hand_labels()
        described = {"session": session.about, "hand_labels": asdict(labels) if labels.version else {}}
        for name, content in described.items():
            if content:
                writer.add_metadata(name, {_text(key): _text(value) for key, value in content.items()})
        channels, sequences, streams = dict[str, int](), Counter[str](), list[Iterator[_Message]]()
        present = [(table, finger) for table in TABLES for finger in session.fingers(table.kind)]
        for table, finger in present:
            name, first = topic(table, finger), next(session.read(table.kind, finger, 1))
            if name not in channels:
                schema = message_schema(table, type(first), first.cells)
                number = writer.register_schema(schema["title"], "jsonschema", msgspec.json.encode(schema))
                channels[name] = writer.register_channel(name, "json", number)
            streams.append(_rows(session, table, finger))
        for time, name, data in merge(*streams, key=itemgetter(0)):
            writer.add_message(channels[name], time, data, time, sequences[name])
            sequences[name] += 1
        writer.finish()
    return dict(sequences)


def topic(table: Table, finger: int) -> str:
    """Return the topic of a table's rows.

    >>> from storage.layout import MOTION
    >>> topic(SLIPS, 2), topic(MOTION, EVERY)
    ('/slip/2', '/motion')
    """
    name = "slip" if table is SLIPS else table.name
    return f"/{name}/{finger}" if table.finger and table.name != FAULTS.name else f"/{name}"


def message_schema(table: Table, kind: type[Batch], cells: int = BAROMETERS) -> dict[str, Any]:
    """Return the JSON schema of a table's messages; descriptions state the units."""
    properties = {"timestamp": {**_STAMP, "title": "time", "description": "event time, since 1970 UTC"}}
    if table.finger:
        properties["finger"] = {"type": "integer", "description": "fingertip"}
    for name, column in table.columns.items():
        if name != "time":
            properties[name] = _property(name, column, column.sizes(cells))
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"slipflow.{kind.__name__}",
        "description": (kind.__doc__ or "").partition("\n")[0],
        "type": "object",
        "properties": properties,
    }


def messages(table: Table, batch: Batch) -> Iterator[tuple[int, bytes]]:
    """Yield the event time (ns) and the message of each row.

    Raises:
        InputError: if a row is from before 1970, which MCAP cannot represent.
    """
    stored = [(name, column) for name, column in table.columns.items() if name != "time"]
    columns = [(name, _values(getattr(batch, name), column)) for name, column in stored]
    for row, time in enumerate(batch.time.tolist()):
        if time < 0:
            reason = "is from before 1970, which MCAP cannot represent: export to lerobot"
            raise InputError(f"{table.name}, a row at {time} ns", reason)
        message: dict[str, Any] = {"timestamp": _stamp(time)}
        if batch.finger != EVERY:
            message["finger"] = batch.finger
        message |= {name: values[row] for name, values in columns if values[row] is not None}
        yield time, msgspec.json.encode(message)


def _rows(session: Session, table: Table, finger: int) -> Iterator[_Message]:
    """Yield the rows of a fingertip."""
    for batch in session.read(table.kind, finger):
        for time, data in messages(table, batch):
            yield time, topic(table, finger), data


def _property(name: str, column: Column, sizes: tuple[int, ...]) -> dict[str, Any]:
    if _is_span(column):
        return {**_STAMP, "title": "time", "description": column.unit}
    if column.names:
        return {"type": "string", "enum": [*column.names]}
    unknown = "; null or omitted: unknown" if column.dtype.kind == "f" else ""
    description = f"{column.unit}{unknown}".removeprefix("; ")
    value: dict[str, Any] = {"type": _TYPES[column.dtype.kind]}
    if sizes:
        value = {"type": "array", "items": value, "minItems": sizes[0], "maxItems": sizes[0]}
    return {**value, "description": description} if description else value


def _values(values: NDArray[Any], column: Column) -> list[Any]:
    """Return the JSON value of each row of a column; None if it has no finite value."""
    if _is_span(column):
        return [_stamp(value) for value in values.tolist()]
    if column.names:
        return [column.names[code] for code in values.tolist()]
    known = np.isfinite(values).reshape(len(values), -1).any(axis=1)
    return [row if any_known else None for row, any_known in zip(values.tolist(), known, strict=True)]


def _is_span(column: Column) -> bool:
    return column.dtype == np.int64 and column.unit == "ns"


def _stamp(time: int) -> dict[str, int]:
    sec, nsec = divmod(time, s)
    return {"sec": sec, "nsec": nsec}


def _text(value: object) -> str:
    """Return a text, or the JSON of another value, without what UTF-8 cannot encode."""
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, separators=(",", ":"))
    return text.encode(errors="replace").decode()
