"""Reader of ROS 2 bags through the rosbags library, an extra."""

import hashlib
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from connectors.files.column_map import natural
from connectors.files.mcap_table import hash_file, mcap_messages
from connectors.files.message_table import Message, read_topic
from connectors.files.ros_messages import check_rosbags, ros_decoder
from connectors.files.trace_table import TraceTable
from operators.errors import InputError

ENDINGS: Final = (".mcap", ".db3")


def is_bag(path: Path) -> bool:
    """Return True for a folder with the files of a ROS 2 bag, and for such a .db3 file."""
    return path.suffix == ".db3" or (path.is_dir() and bool(_files(path)))


def read_bag(path: Path, topic: str = "", motion_topic: str = "") -> TraceTable:
    """Read a topic of a ROS 2 bag, see `read_topic`.

    The files of a bag are read in the order of the numbers in their names. Messages without a definition in
    the bag have that of the newest ROS 2 release that rosbags supports.

    Args:
        path: Folder of the bag, or a .db3 file.
        topic: Topic of the fingertip; empty: the only topic.
        motion_topic: Topic with the motion; empty: the same.

    Raises:
        InputError: if rosbags is not installed, the bag cannot be read or is compressed, or there is no such
            topic.
    """
    check_rosbags()
    files = _files(path) if path.is_dir() else [path]
    digests = [hash_file(file) for file in files]
    sha256 = digests[0] if len(files) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()
    return read_topic(partial(_messages, files), str(path), topic, motion_topic, sha256=sha256)


def _files(folder: Path) -> list[Path]:
    """Return the files of a bag in the order of recording."""
    for ending in ENDINGS:
        if files := sorted(folder.glob(f"*{ending}"), key=lambda path: natural(path.name)):
            return files
    return []


def _messages(files: Sequence[Path]) -> Iterator[Message]:
    for file in files:
        yield from mcap_messages(file) if file.suffix == ".mcap" else _stored(file)


def _stored(path: Path) -> Iterator[Message]:
    """Yield the messages of a .db3 file."""
    from rosbags.rosbag2 import Reader  # noqa: PLC0415 - an extra

    try:
        with Reader(path) as reader:
            for connection, time, data in reader.messages():
                form = {"MSG": "ros2msg", "IDL": "ros2idl"}.get(connection.msgdef.format.name, "")
                definition = connection.msgdef.data
                decoder = partial(ros_decoder, str(path), connection.msgtype, form, definition)
                yield Message(connection.topic, connection.msgtype, time, data, decoder)
    except InputError:
        raise
    except Exception as error:  # rosbags, apsw and ruamel each raise their own
        reason = f"{type(error).__name__} {error}".partition("\n")[0]
        raise InputError(str(path), f"is damaged or not a ROS 2 bag: {reason:.200}") from error
