"""A session as one MCAP file, which Foxglove and others open: every row a JSON message, in time order."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from heapq import merge
from importlib.util import find_spec
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, TypeAlias

from operators.batch import Batch
from operators.errors import InputError
from storage.exports import mcap_messages
from storage.layout import TABLES, Table
from storage.partial import partial_file
from storage.session import Session

_CHUNK: Final = 1 << 20  # bytes of messages that are compressed together
_OFTEN: Final = 5000  # rows between two tellings of progress

_Message: TypeAlias = tuple[int, int, bytes]  # ns, channel, JSON


def export(
    session: Session, path: Path, progress: Callable[[int], object] = lambda _rows: None
) -> Mapping[str, int]:
    """Write a session; give how many messages each topic has.

    Streams are read part by part and merged, so a long session takes no more memory than a short one. Late
    rows stand where they were recorded; the file's index gives them in their place. What session.json says
    is the metadata record "session", a JSON text to each of its keys.

    Args:
        session: What to write.
        path: The file, which must not be there.
        progress: Told how many rows are written, now and then.

    Raises:
        InputError: if the library is not installed, or the session is damaged.
        EndpointError: if the file is there already, or cannot be written; nothing is left then.
    """
    if find_spec("mcap") is None:
        raise InputError("MCAP export", "needs mcap: in the clone, pip install -e '.[mcap]'")
    from mcap.writer import Writer  # noqa: PLC0415 - an extra

    with partial_file(path) as file:
        writer: Any = Writer(file, chunk_size=_CHUNK, compression=_compression())
        writer.start(profile="", library=str(session.about.get("software", "slipflow")))
        described = {key: _text(value) for key, value in session.about.items()}
        writer.add_metadata("session", described)
        channels = _Channels(writer)
        streams = [
            _rows(session, channels, table, finger)
            for table in TABLES
            for finger in session.fingers(table.kind)
        ]
        rows = merge(*streams, key=itemgetter(0))
        sequences = Counter[int]()
        for done in iter(lambda: list(islice(rows, _OFTEN)), []):
            for time, channel, data in done:
                writer.add_message(channel, time, data, time, sequences[channel])
                sequences[channel] += 1
            progress(sequences.total())
        writer.finish()
    return {channels.topics[channel]: count for channel, count in sequences.items()}


@dataclass
class _Channels:
    """The topics of a file, each registered with its schema when its first row comes."""

    writer: Any
    topics: dict[int, str] = field(default_factory=dict[int, str])  # by number
    _schemas: dict[str, int] = field(default_factory=dict[str, int])  # number by name
    _numbers: dict[str, int] = field(default_factory=dict[str, int])  # by topic

    def number(self, topic: str, schema: dict[str, Any]) -> int:
        """The number of a topic's channel."""
        if topic not in self._numbers:
            name = str(schema["title"])
            if name not in self._schemas:
                encoded = mcap_messages.encode(schema)
                self._schemas[name] = self.writer.register_schema(name, "jsonschema", encoded)
            number = self.writer.register_channel(topic, "json", self._schemas[name])
            self._numbers[topic], self.topics[number] = number, topic
        return self._numbers[topic]


def _rows(session: Session, channels: _Channels, table: Table, finger: int) -> Iterator[_Message]:
    for batch in session.read(table.kind, finger):
        channel = _channel(channels, table, batch)
        for time, data in mcap_messages.messages(table, batch):
            yield time, channel, data


def _channel(channels: _Channels, table: Table, batch: Batch) -> int:
    schema = mcap_messages.schema(table, type(batch))
    return channels.number(mcap_messages.topic(table, batch.finger), schema)


def _text(value: object) -> str:
    return value if isinstance(value, str) else mcap_messages.encode(value).decode()


def _compression() -> Any:  # noqa: ANN401 - of the library, which is an extra
    """The best that is installed."""
    from mcap.writer import CompressionType  # noqa: PLC0415 - an extra

    if find_spec("zstandard"):
        return CompressionType.ZSTD
    return CompressionType.LZ4 if find_spec("lz4") else CompressionType.NONE
