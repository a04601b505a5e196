"""Export of a session to one MCAP file, for Foxglove: every row is a JSON message, in time order."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from heapq import merge
from importlib.util import find_spec
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, TypeAlias

from operators.batch import Batch
from operators.extras import require_extra
from storage.exports import mcap_messages
from storage.files import partial_file
from storage.layout import TABLES, Table
from storage.session import Session

_CHUNK: Final = 1 << 20  # bytes of messages per compressed chunk
_BATCH: Final = 5000  # rows between progress updates

_Message: TypeAlias = tuple[int, int, bytes]  # ns, channel, JSON


def export(
    session: Session,
    path: Path,
    progress: Callable[[int], object] = lambda _rows: None,
    *,
    span: tuple[int, int] | None = None,
) -> Mapping[str, int]:
    """Write a session; return the number of messages of each topic.

    Streams are read part by part and merged, so memory does not grow with the session. Late rows are in the
    order of recording; the file's index sorts them by time. session.json becomes the metadata record
    "session", with JSON text for each key; labels given by hand become "hand_labels", if there are any.

    Args:
        session: Session to write.
        path: File to create.
        progress: Called with the number of rows written so far.
        span: First and last event time of the rows, ns; None: all rows.

    Raises:
        InputError: if the library is not installed, or the session is damaged.
        EndpointError: if the file exists or cannot be written; then nothing is left of it.

    References:
        MCAP format specification, https://mcap.dev/spec
    """
    require_extra("mcap", "MCAP export")
    from mcap.writer import Writer  # noqa: PLC0415 - an extra

    with partial_file(path) as file:
        writer: Any = Writer(file, chunk_size=_CHUNK, compression=_compression())
        writer.start(profile="", library=str(session.about.get("software", "slipflow")))
        labels = session.hand_labels()
        described = {"session": session.about, "hand_labels": asdict(labels) if labels.version else {}}
        for name, content in described.items():
            if content:
                writer.add_metadata(name, {key: _text(value) for key, value in content.items()})
        channels = _Channels(writer)
        streams = [
            _rows(session, channels, table, finger, span)
            for table in TABLES
            for finger in session.fingers(table.kind)
        ]
        rows = merge(*streams, key=itemgetter(0))
        sequences = Counter[int]()
        for done in iter(lambda: list(islice(rows, _BATCH)), []):
            for time, channel, data in done:
                writer.add_message(channel, time, data, time, sequences[channel])
                sequences[channel] += 1
            progress(sequences.total())
        writer.finish()
    return {channels.topics[channel]: count for channel, count in sequences.items()}


@dataclass
class _Channels:
    """Topics of a file; each is registered with its schema at its first row."""

    writer: Any
    topics: dict[int, str] = field(default_factory=dict[int, str])  # by channel number
    _schemas: dict[str, int] = field(default_factory=dict[str, int])  # schema numbers by name
    _numbers: dict[str, int] = field(default_factory=dict[str, int])  # channel numbers by topic

    def number(self, topic: str, schema: dict[str, Any]) -> int:
        """Return the channel number of a topic."""
        if topic not in self._numbers:
            name = str(schema["title"])
            if name not in self._schemas:
                encoded = mcap_messages.encode(schema)
                self._schemas[name] = self.writer.register_schema(name, "jsonschema", encoded)
            number = self.writer.register_channel(topic, "json", self._schemas[name])
            self._numbers[topic], self.topics[number] = number, topic
        return self._numbers[topic]


def _rows(
    session: Session, channels: _Channels, table: Table, finger: int, span: tuple[int, int] | None
) -> Iterator[_Message]:
    for read in session.read(table.kind, finger):
        batch = read if span is None else read[(read.time >= span[0]) & (read.time <= span[1])]
        if not len(batch):
            continue
        channel = _channel(channels, table, batch)
        for time, data in mcap_messages.messages(table, batch):
            yield time, channel, data


def _channel(channels: _Channels, table: Table, batch: Batch) -> int:
    schema = mcap_messages.schema(table, type(batch), batch.cells)
    return channels.number(mcap_messages.topic(table, batch.finger), schema)


def _text(value: object) -> str:
    return value if isinstance(value, str) else mcap_messages.encode(value).decode()


def _compression() -> Any:  # noqa: ANN401 - type of an extra
    """Return the best compression whose library is installed."""
    from mcap.writer import CompressionType  # noqa: PLC0415 - an extra

    if find_spec("zstandard"):
        return CompressionType.ZSTD
    return CompressionType.LZ4 if find_spec("lz4") else CompressionType.NONE
