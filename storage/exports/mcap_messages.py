"""Rows of a session as MCAP messages: topics, JSON schemas and JSON.

Columns have the same names as in Parquet. Timestamps and durations in ns become ``{"sec", "nsec"}``, which
Foxglove shows as times and which no reader rounds. JSON has no NaN: values that are not finite become null,
and a column without any finite value is omitted from its message.
"""

import json
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from operators.batch import BAROMETERS, EVERY, Batch, Column, s
from operators.errors import InputError
from storage.layout import CLOCKS, EPISODES, FAULTS, MOTION, SAMPLES, SLIPS, TOUCH, TRUTH, Table

TOPICS: Final[Mapping[str, str]] = MappingProxyType(
    {
        TOUCH.name: "/touch/{finger}",
        MOTION.name: "/motion",
        SAMPLES.name: "/samples/{finger}",
        SLIPS.name: "/slip/{finger}",
        FAULTS.name: "/faults",
        CLOCKS.name: "/clocks",
        EPISODES.name: "/episodes",
        TRUTH.name: "/truth/{finger}",
    }
)

_JSON: Final = json.JSONEncoder(separators=(",", ":"), allow_nan=False)  # slow to create
_INT64: Final = np.dtype(np.int64)
_STAMP: Final[Mapping[str, Any]] = MappingProxyType(
    {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
)


def topic(table: Table, finger: int) -> str:
    """Return the topic of a table's rows.

    >>> topic(SLIPS, 2), topic(MOTION, EVERY)
    ('/slip/2', '/motion')
    """
    return TOPICS[table.name].format(finger=finger)


def schema(table: Table, kind: type[Batch], cells: int = BAROMETERS) -> dict[str, Any]:
    """Return the JSON schema of a table's messages; descriptions state the units.

    >>> schema(TOUCH, TOUCH.kind)["properties"]["counts"]["description"]
    'count'
    """
    properties = {"timestamp": {**_STAMP, "title": "time", "description": "event time, since 1970 UTC"}}
    if table.finger:
        properties["finger"] = {"type": "integer", "description": "fingertip"}
    for name, column in table.columns.items():
        if name != "time":
            properties[name] = _property(name, column, column.sizes(cells))
    return _object(kind.__name__, (kind.__doc__ or "").partition("\n")[0], properties)


def messages(table: Table, batch: Batch) -> Iterator[tuple[int, bytes]]:
    """Yield the event time (ns) and the message of each row.

    Raises:
        InputError: if a row is from before 1970, which MCAP cannot represent.
    """
    columns = [
        (name, _values(getattr(batch, name), column))
        for name, column in table.columns.items()
        if name != "time"
    ]
    for row, time in enumerate(batch.time.tolist()):
        message: dict[str, Any] = {"timestamp": _stamp(_check_time(table.name, time))}
        if batch.finger != EVERY:
            message["finger"] = batch.finger
        message |= {name: values[row] for name, values in columns if values[row] is not None}
        yield time, encode(message)


def encode(content: Any) -> bytes:  # noqa: ANN401 - any JSON value
    """Return compact JSON."""
    return _JSON.encode(content).encode()


def _check_time(table: str, time: int) -> int:
    if time < 0:
        raise InputError(
            f"{table}, a row at {time} ns",
            "is from before 1970, which MCAP cannot represent: export to lerobot or rrd",
        )
    return time


def _property(name: str, column: Column, sizes: tuple[int, ...]) -> dict[str, Any]:
    if _is_span(column):
        title = "duration" if name == "offset" else "time"
        return {**_STAMP, "title": title, "description": column.unit}
    if column.names:
        return {"type": "string", "enum": [*column.names]}
    types = {"b": "boolean", "i": "integer", "f": "number"}
    unknown = "; null or omitted: unknown" if column.dtype.kind == "f" else ""
    description = f"{column.unit}{unknown}".removeprefix("; ")
    value: dict[str, Any] = {"type": types[column.dtype.kind]}
    if sizes:
        value = {"type": "array", "items": value, "minItems": sizes[0], "maxItems": sizes[0]}
    return {**value, "description": description} if description else value


def _object(title: str, description: str, properties: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"slipflow.{title}",
        "description": description,
        "type": "object",
        "properties": dict(properties),
    }


def _values(values: NDArray[Any], column: Column) -> list[Any]:
    """Return the JSON value of each row of a column; None if it has no finite value."""
    if _is_span(column):
        return [_stamp(value) for value in values.tolist()]
    if column.names:
        return [column.names[code] for code in values.tolist()]
    listed: list[Any] = values.tolist()
    if column.dtype.kind != "f" or (finite := np.isfinite(values)).all():
        return listed
    if not column.shape:
        return [value if known else None for value, known in zip(listed, finite.tolist(), strict=True)]
    rows = zip(listed, finite.tolist(), strict=True)
    return [
        [value if known else None for value, known in zip(row, there, strict=True)] if any(there) else None
        for row, there in rows
    ]


def _is_span(column: Column) -> bool:
    return column.dtype == _INT64 and column.unit == "ns"


def _stamp(time: int) -> dict[str, int]:
    sec, nsec = divmod(time, s)
    return {"sec": sec, "nsec": nsec}
