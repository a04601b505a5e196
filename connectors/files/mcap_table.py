"""Reader of MCAP files with JSON or ROS 2 messages; sizes are checked before chunks are unpacked."""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from connectors.files.message_table import Decode, Message, read_topic
from connectors.files.ros_messages import ros_decoder
from connectors.files.trace_table import TraceTable
from operators.errors import InputError, os_error_reason
from operators.extras import require_extra

if TYPE_CHECKING:
    from mcap.records import Chunk, Schema

RECORD_LIMIT: Final = 1 << 28  # bytes of a record, and of an unpacked chunk
_BLOCK: Final = 1 << 20  # bytes read at once


def read_mcap(path: Path, topic: str = "", motion_topic: str = "") -> TraceTable:
    """Read a topic of an MCAP file, see `read_topic`.

    Raises:
        InputError: if the library is not installed, the file cannot be read or is damaged, there is no such
            topic, or its messages are neither JSON nor ROS 2.
    """
    messages = partial(mcap_messages, path)
    return read_topic(messages, str(path), topic, motion_topic, sha256=hash_file(path))


def hash_file(path: Path) -> str:
    """Return the sha256 (hex) of a file.

    Raises:
        InputError: if it cannot be read.
    """
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(_BLOCK):
                digest.update(block)
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {os_error_reason(error)}") from None
    return digest.hexdigest()


def mcap_messages(path: Path) -> Iterator[Message]:
    """Yield the messages of an MCAP file.

    Raises:
        InputError: if the library is not installed, or the file cannot be read or is damaged.
    """
    require_extra("mcap", "MCAP import")
    try:
        yield from _messages(path)
    except InputError:
        raise
    except Exception as error:  # mcap, struct, zstandard and lz4 each raise their own
        reason = f"{type(error).__name__} {error}".partition("\n")[0]
        fix = "try `mcap recover`"
        raise InputError(str(path), f"is damaged, cut off or not MCAP: {reason:.200}; {fix}") from error


def _messages(path: Path) -> Iterator[Message]:
    from mcap import records  # noqa: PLC0415 - an extra
    from mcap.stream_reader import StreamReader, breakup_chunk  # noqa: PLC0415 - an extra

    schemas, channels = dict[int, "Schema"](), dict[int, records.Channel]()
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True, record_size_limit=RECORD_LIMIT).records:
            inner = breakup_chunk(_unpacked(record)) if isinstance(record, records.Chunk) else [record]
            for each in inner:
                if isinstance(each, records.Schema):
                    schemas[each.id] = each
                elif isinstance(each, records.Channel):
                    channels[each.id] = each
                elif isinstance(each, records.Message):
                    channel = channels[each.channel_id]
                    schema = schemas.get(channel.schema_id)
                    kind = schema.name if schema else channel.message_encoding
                    decoder = partial(_decoder, str(path), channel.message_encoding, schema)
                    yield Message(channel.topic, kind, each.log_time, each.data, decoder)


def _unpacked(chunk: "Chunk") -> "Chunk":
    """Return a chunk without compression.

    Raises:
        ValueError: if it does not unpack to the size that it declares, or is too large.
    """
    size = chunk.uncompressed_size
    if size > RECORD_LIMIT:
        raise ValueError(f"a chunk unpacks to more than {RECORD_LIMIT >> 20} MiB")
    if chunk.compression == "zstd":
        zstandard: Any = import_module("zstandard")  # comes with mcap
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            data: Any = reader.read(size + 1)
    elif chunk.compression == "lz4":
        lz4: Any = import_module("lz4.frame")  # comes with mcap, without types
        data = lz4.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression!r} is not supported")
    if len(data) != size:
        raise ValueError(f"a chunk does not unpack to the {size} bytes that it declares")
    return replace(chunk, compression="", data=data)


def _decoder(where: str, encoding: str, schema: "Schema | None") -> Decode:
    """Return the function that decodes the messages of a channel."""
    if encoding == "json":
        return json.loads
    if encoding == "cdr" and schema is not None:
        return ros_decoder(where, schema.name, schema.encoding, schema.data.decode())
    reason = f"has {encoding} messages; only json and cdr (ROS 2) can be read: convert them"
    raise InputError(where, reason)
