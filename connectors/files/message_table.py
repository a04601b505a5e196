"""Tables of the messages of a topic, from MCAP files and ROS 2 bags."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from itertools import islice
from typing import Any, Final, NamedTuple, Protocol, TypeAlias, cast

import numpy as np
import polars as pl

from connectors.files import trace_table
from connectors.files.trace_table import TraceTable
from operators.batch import s
from operators.errors import InputError

LOG_TIME: Final = "log_time_ns"  # column with the time of recording
STAMPS: Final = ("header.stamp_ns", "timestamp_ns", "stamp_ns")  # columns with the time of measurement
WIDTH_LIMIT: Final = 4096  # values of an array
COLUMN_LIMIT: Final = 8192

_ROWS: Final = 4096  # messages that are converted at once
_DEPTH: Final = 20  # of nested messages
_VALUE_SIZE: Final = 16  # bytes, at most, of a number in a table

Decode: TypeAlias = Callable[[bytes], object]


class Message(NamedTuple):
    """Message of a recording."""

    topic: str
    kind: str  # name of its schema
    time: int  # ns, of recording
    data: bytes
    decoder: "Callable[[], Decode]"  # returns the function that decodes `data`


class Recorded(Protocol):
    """Recording whose messages can be read repeatedly."""

    def __call__(self) -> Iterator[Message]:
        """Yield the messages in the order of recording."""
        ...


def read_topic(
    messages: Recorded, where: str, topic: str, motion_topic: str = "", *, sha256: str = ""
) -> TraceTable:
    """Return the messages of a topic as a table; nested fields become columns ``name.field`` and ``name0``.

    Stamps, such as that of a ROS header, become columns in ns. The table is sorted by the stamp or, without
    one, by the time of recording.

    Args:
        messages: The recording.
        where: Its name in messages.
        topic: Topic of the fingertip; empty: the only topic of the recording.
        motion_topic: Topic with the motion; empty: the same.
        sha256: Checksum of the recording, hex.

    Raises:
        InputError: if there is no such topic, or its messages cannot be decoded or are too large.
    """
    if not topic:
        found = Counter((message.topic, message.kind) for message in messages())
        if len({name for name, _ in found}) != 1:
            raise _no_topic(where, found, "choose one with --topic")
        ((topic, _),) = found
    table = _table(messages, where, topic, sha256)
    table.about = {"topic": topic}
    if motion_topic:
        table.motion = _table(messages, where, motion_topic, sha256)
        table.about = {"topic": topic, "motion_topic": motion_topic}
    return table


def _no_topic(where: str, found: Mapping[tuple[str, str], int], reason: str) -> InputError:
    listed = ", ".join(f"{name} ({kind}, {count})" for (name, kind), count in sorted(found.items()))
    return InputError(where, f"has the topics {listed or 'none'}: {reason}" if listed else "has no messages")


def _table(messages: Recorded, where: str, topic: str, sha256: str) -> TraceTable:
    seen = Counter[tuple[str, str]]()
    place = f"{where}, topic {topic}"
    left_out = dict[str, str]()
    rows = _rows(messages, topic, place, seen, left_out)
    frames, values = list[pl.DataFrame](), 0
    for chunk in iter(lambda: list(islice(rows, _ROWS)), []):
        names = dict.fromkeys(name for row in chunk for name in row)
        columns = {name: _column([row.get(name) for row in chunk]) for name in names}
        frames.append(pl.DataFrame(columns))
        values += len(names) * len(chunk)
        if values * _VALUE_SIZE > trace_table.LIMIT or len(names) > COLUMN_LIMIT:
            limit = f"has more than {trace_table.LIMIT >> 20} MiB of values, the limit"
            raise InputError(place, f"{limit}: split the recording into several files")
    if not frames:
        raise _no_topic(where, seen, f"there is no {topic}")
    frame = pl.concat(frames, how="diagonal_relaxed")
    time = next((name for name in STAMPS if _is_stamp(frame, name)), LOG_TIME)
    frame = frame.sort(time, maintain_order=True)
    columns = {name: frame[name] for name in frame.columns}
    return TraceTable(
        columns, where, where=place, place="message", sha256=sha256, time=time, left_out=left_out
    )


def _rows(
    messages: Recorded, topic: str, place: str, seen: Counter[tuple[str, str]], left_out: dict[str, str]
) -> Iterator[dict[str, object]]:
    """Yield the columns of each message of a topic."""
    number = 0
    for message in messages():
        seen[message.topic, message.kind] += 1
        if message.topic != topic:
            continue
        try:
            row: dict[str, object] = {LOG_TIME: message.time}
            row.update(_flat("", message.decoder()(message.data), left_out))
        except InputError:
            raise
        except Exception as error:  # json, struct, numpy and rosbags each raise their own
            reason = f"{type(error).__name__} {error}".partition("\n")[0]
            raise InputError(f"{place}, message {number}", f"cannot be decoded: {reason:.200}") from error
        number += 1
        yield row


def _flat(name: str, value: object, left_out: dict[str, str], depth: int = 0) -> Iterator[tuple[str, object]]:
    """Yield the scalar fields of a value by their names."""
    if depth > _DEPTH:
        raise ValueError(f"it is nested more than {_DEPTH} levels deep")
    if isinstance(value, np.ndarray):
        value = cast("list[object]", value.tolist()) if value.size <= WIDTH_LIMIT else [None] * value.size
    if is_dataclass(value) and not isinstance(value, type):  # a ROS message
        value = {each.name: getattr(value, each.name) for each in fields(value) if each.name != "__msgtype__"}
    if isinstance(value, Mapping):
        inner = cast("Mapping[str, object]", value)
        if (stamp := _stamp(inner)) is not None:
            yield f"{name or 'stamp'}_ns", stamp
            return
        for key, each in inner.items():
            yield from _flat(f"{name}.{key}" if name else str(key), each, left_out, depth + 1)
    elif isinstance(value, list | tuple):
        items = cast("Sequence[object]", value)
        if len(items) > WIDTH_LIMIT:
            left_out[name] = f"it has {len(items)} values, {WIDTH_LIMIT} at most"
            return
        for number, each in enumerate(items):
            yield from _flat(f"{name}{number}", each, left_out, depth + 1)
    else:
        yield name or "data", value


def _stamp(value: Mapping[str, object]) -> int | None:
    """Return a time in ns, of ROS (sec, nanosec) or of slipflow's exports (sec, nsec)."""
    rest = value.get("nanosec", value.get("nsec"))
    seconds = value.get("sec")
    if len(value) == 2 and isinstance(rest, int) and isinstance(seconds, int):  # noqa: PLR2004 - these two
        return seconds * s + rest
    return None


def _column(values: Iterable[Any]) -> pl.Series:
    """Return a column of numbers or texts; other values are missing."""
    given = list(values)
    if any(isinstance(value, str) for value in given):
        return pl.Series([None if value is None else str(value) for value in given], dtype=pl.String)
    if all(isinstance(value, int | None) for value in given) and all(
        abs(value) < 1 << 63 for value in given if value is not None
    ):
        return pl.Series(given, dtype=pl.Int64)
    return pl.Series(
        [float(value) if isinstance(value, int | float) else None for value in given], dtype=pl.Float64
    )


def _is_stamp(frame: pl.DataFrame, name: str) -> bool:
    if name not in frame.columns or frame[name].dtype != pl.Int64:
        return False
    return frame[name].null_count() == 0 and cast("int", frame[name].min()) > 0
