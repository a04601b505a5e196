"""Reader of ROS 2 bags through the rosbags library, an extra."""

import hashlib
from collections.abc import Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from connectors.files.column_map import natural
from connectors.files.mcap_table import hash_file, mcap_messages
from connectors.files.message_table import Decode, Message, read_topic
from connectors.files.trace_table import TraceTable
from operators.errors import InputError

ENDINGS: Final = (".mcap", ".db3")
_RULE: Final = "=" * 80 + "\n"


def is_bag(path: Path) -> bool:
    """Return True for a folder with the files of a ROS 2 bag, and for such a .db3 file."""
    return path.suffix == ".db3" or (path.is_dir() and bool(_files(path)))


def read_bag(path: Path, topic: str = "", motion_topic: str = "") -> TraceTable:
    """Read a topic of a ROS 2 bag, see `read_topic`.

    The files of a bag are read in the order of the numbers in their names. Messages without a definition in
    the bag have that of the newest ROS 2 release that rosbags knows.

    Args:
        path: Folder of the bag, or a .db3 file.
        topic: Topic of the fingertip; empty: the only topic.
        motion_topic: Topic with the motion; empty: the same.

    Raises:
        InputError: if rosbags is not installed, the bag cannot be read or is compressed, or there is no such
            topic.
    """
    _check_installed()
    files = _files(path) if path.is_dir() else [path]
    digests = [hash_file(file) for file in files]
    sha256 = digests[0] if len(files) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()
    return read_topic(partial(_messages, files), str(path), topic, motion_topic, sha256=sha256)


def ros_decoder(where: str, name: str, form: str, definition: str) -> Decode:
    """Return a function that decodes the CDR messages of a type.

    Args:
        where: Name of the file in messages.
        name: Name of the type, such as ``sensor_msgs/msg/JointState``.
        form: Format of the definition: ``ros2msg`` or ``ros2idl``; otherwise there is none.
        definition: The definition, with those of the types in it.

    Raises:
        InputError: if rosbags is not installed, or the type is unknown.
    """
    _check_installed()
    from rosbags import typesys  # noqa: PLC0415 - an extra

    defined = bool(definition) and form in ("ros2msg", "ros2idl")
    store = typesys.get_typestore(typesys.Stores.EMPTY if defined else typesys.Stores.LATEST)
    try:
        if defined and form == "ros2msg":
            store.register(typesys.get_types_from_msg(definition, name))
        elif defined:
            for part in definition.split(_RULE):  # one per type, below a line with its name
                idl = part.partition("\n")[2] if part.startswith("IDL: ") else part
                store.register(typesys.get_types_from_idl(idl) if idl.strip() else {})
        known = name in store.types
    except Exception as error:  # typesys raises several
        reason = f"{type(error).__name__} {error}".partition("\n")[0]
        raise InputError(where, f"has an invalid definition of {name}: {reason:.200}") from error
    if not known:
        raise InputError(where, f"has messages of type {name} without its definition: convert it to MCAP")
    return partial(_decode, store, name)


def _decode(store: Any, name: str, data: bytes) -> object:  # noqa: ANN401 - a type store of rosbags
    message: object = store.deserialize_cdr(data, name)
    return message


def _check_installed() -> None:
    if find_spec("rosbags") is None:
        raise InputError("ROS 2 import", "needs rosbags: in the clone, pip install -e '.[ros]'")


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
